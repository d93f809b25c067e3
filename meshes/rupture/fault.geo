// A box of 40 km by 24 km in squares of side h, with a fault of 30 km in its middle.
h = 100;
x[] = {-20000, -15000, 15000, 20000};
y[] = {-12000, 0, 12000};
For j In {0:2}
  For i In {0:3}
    Point(10*j + i + 1) = {x[i], y[j], 0};
  EndFor
EndFor
For j In {0:2}
  For i In {0:2}
    Line(100 + 10*j + i) = {10*j + i + 1, 10*j + i + 2};
    Transfinite Curve{100 + 10*j + i} = Round((x[i + 1] - x[i])/h) + 1;
  EndFor
EndFor
For j In {0:1}
  For i In {0:3}
    Line(200 + 10*j + i) = {10*j + i + 1, 10*j + i + 11};
    Transfinite Curve{200 + 10*j + i} = Round((y[j + 1] - y[j])/h) + 1;
  EndFor
EndFor
For j In {0:1}
  For i In {0:2}
    Curve Loop(10*j + i + 1) = {100 + 10*j + i, 200 + 10*j + i + 1, -(110 + 10*j + i), -(200 + 10*j + i)};
    Plane Surface(10*j + i + 1) = {10*j + i + 1};
  EndFor
EndFor
Transfinite Surface "*";
Recombine Surface "*";
Physical Surface("rock") = {1, 2, 3, 11, 12, 13};
Physical Curve("fault") = {111};
Physical Curve("south") = {100, 101, 102};
Physical Curve("north") = {120, 121, 122};
Physical Curve("west") = {200, 210};
Physical Curve("east") = {203, 213};

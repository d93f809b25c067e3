// A box of 18 km by 15 km with a fault of 3 km in its middle: cells as long as h, as high along the fault and, as they grow in
// equal shares, far times as high at the sides.
h = 62.5;
far = 6;
half = 1500;
side = 9000;
up = 7500;
rows = Round(Log(far)/Log(1 + (far - 1)*h/up));
growth = far^(1/rows);
sides = Round(Log(far)/Log(1 + (far - 1)*h/(side - half)));
wider = far^(1/sides);
x[] = {-side, -half, half, side};
y[] = {-up, 0, up};
For j In {0:2}
  For i In {0:3}
    Point(10*j + i + 1) = {x[i], y[j], 0};
  EndFor
EndFor
For j In {0:2}
  For i In {0:2}
    Line(100 + 10*j + i) = {10*j + i + 1, 10*j + i + 2};
  EndFor
  Transfinite Curve{100 + 10*j + 1} = Round(2*half/h) + 1;
  Transfinite Curve{100 + 10*j} = sides + 1 Using Progression 1/wider;
  Transfinite Curve{100 + 10*j + 2} = sides + 1 Using Progression wider;
EndFor
For j In {0:1}
  For i In {0:3}
    Line(200 + 10*j + i) = {10*j + i + 1, 10*j + i + 11};
    Transfinite Curve{200 + 10*j + i} = rows + 1 Using Progression growth^(2*j - 1);
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

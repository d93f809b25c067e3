"""A .geo as a program: ordinary geometry passes the list of statements, whatever runs, reads or writes is refused."""

from __future__ import annotations

import re

import pytest
from meshing import MESHES

from fracflow.errors import InputError
from fracflow.mesh.files import geo_tokens
from fracflow.mesh.files.geo_check import check_geo
from fracflow.mesh.files.geo_depth import DEEPEST
from fracflow.mesh.read import read_mesh
from fracflow.remarks import bare

pytestmark = pytest.mark.serial

SQUARE = """
h = 0.5;
Point(1) = {0, 0, 0, h}; Point(2) = {1, 0, 0, h}; Point(3) = {1, 1, 0, h}; Point(4) = {0, 1, 0, h};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1:4}; Plane Surface(1) = {1};
Physical Surface("rock") = {1};
"""

ORDINARY = {
    "arcs": """
        r = 1; c = newp; Point(c) = {0, 0, 0};
        For i In {0:3}
          p~{i} = newp; Point(p~{i}) = {r*Cos(i*Pi/2), r*Sin(i*Pi/2), 0, 0.2};
        EndFor
        For i In {0:3}
          l~{i} = newl; j = (i + 1) % 4; Circle(l~{i}) = {p~{i}, c, p~{j}};
        EndFor
        Curve Loop(1) = {l~{0}, l~{1}, l~{2}, l~{3}}; Plane Surface(1) = {1};
        Ellipse(90) = {1, 2, 3, 4}; Spline(91) = {1:4}; BSpline(92) = {1, 2, 3}; Bezier(93) = {1, 2, 3, 4};
        Physical Surface("rock", 7) = {1}; Physical Curve("rim", 8) = {l~{0}:l~{3}};""",
    "constants": SQUARE
    + """
        DefineConstant[ n = {4, Min 1, Max 20, Step 1, Name "Mesh/cells along a side"},
                        k = {0, Choices{0="triangles", 1="quads"}, Name "Mesh/kind", Visible (n > 2)}, q = 3 ];
        m = DefineNumber[ 0.1, Name "Mesh/size", Help "of cells", ReadOnly 0 ];
        If (k == 1) Recombine Surface {1}; EndIf
        Transfinite Curve {1:4} = n + 1 Using Progression 1.1; Transfinite Surface {1} = {1, 2, 3, 4} Alternate;""",
    "opencascade": """
        SetFactory("OpenCASCADE");
        Rectangle(1) = {0, 0, 0, 4, 2, 0}; Disk(2) = {2, 1, 0, 0.5}; Rectangle(3) = {1, 0, 0, 1, 1};
        a() = BooleanDifference{ Surface{1}; Delete; }{ Surface{2}; Delete; };
        BooleanFragments{ Surface{a()}; Delete; }{ Surface{3}; Delete; }
        b() = BooleanUnion{ Surface{1}; }{ Surface{2}; }; BooleanIntersection(9) = { Surface{1}; }{ Surface{2}; };
        eps = 1e-3;
        left() = Curve In BoundingBox {-eps, -eps, -eps, eps, 2 + eps, eps};
        Physical Curve("left") = {left()}; Physical Surface("rock") = Surface{:};
        all() = Boundary{ Surface{a(0)}; }; more() = Abs(CombinedBoundary{ Surface{:}; });
        Characteristic Length{ PointsOf{ Surface{a()}; } } = 0.1; Coherence; HealShapes;""",
    "moved": SQUARE
    + """
        t[] = Translate {1, 0, 0} { Duplicata { Surface{1}; } };
        Rotate {{0, 0, 1}, {0, 0, 0}, Pi/4} { Surface{t[0]}; }
        Symmetry {1, 0, 0, 0} { Duplicata { Line{1}; } } Dilate {{0, 0, 0}, 2} { Point{1}; }
        e[] = Extrude {0, 1, 0} { Line{3}; Layers{4}; Recombine; };
        Extrude {{0, 0, 1}, {0, 0, 0}, Pi/2} { Point{2}; Layers{{2, 3}, {0.5, 1}}; }
        Delete { Surface{1}; } Recursive Delete { Line{2}; } Hide { Point{1}; } Show "*"; Coherence;
        Color Red { Surface{:}; }""",
    "fields": SQUARE
    + """
        Field[1] = Distance; Field[1].CurvesList = {1, 2}; Field[1].Sampling = 100; Field[1].PointsList = {1};
        Field[2] = Threshold; Field[2].InField = 1; Field[2].SizeMin = h/5; Field[2].SizeMax = h;
        Field[2].DistMin = 0.1; Field[2].DistMax = 0.4;
        Field[3] = Box; Field[3].VIn = h/3; Field[3].VOut = h; Field[3].XMin = 0; Field[3].XMax = 0.5;
        Field[4] = MathEval; Field[4].F = "0.1 + 0.2*Sqrt(x^2 + y^2) + 0*F1";
        Field[5] = MathEval; Field[5].F = Sprintf("F1^3 + %g", h / 30);
        f = newf; Field[f] = Min; Field[f].FieldsList = {2, 3, 4}; Background Field = f;
        Field[20] = Attractor; Field[20].NodesList = {1}; Field[21] = Max; Field[22] = Restrict;
        Mesh.MeshSizeExtendFromBoundary = 0; Mesh.MeshSizeFromPoints = 0; Mesh.Algorithm = 5;""",
    "embedded": SQUARE
    + """
        Point(11) = {0.3, 0.3, 0, h/4}; Point(12) = {0.7, 0.6, 0, h/4}; Line(11) = {11, 12};
        Curve{11} In Surface{1}; Point{11, 12} In Surface{1}; Physical Curve("crack") = {11};
        Transfinite Curve{11} = 9 Using Bump 0.2; MeshSize{11, 12} = 0.05; Periodic Curve{2} = {-4};""",
    "macros": """
        Macro Cell  // x, y and n are its arguments
          p = newp; Point(p) = {x, y, 0, 0.3};
          corners[n] = p; n += 1;
        Return
        Function Twice
          x = 0; Call Cell;
          x = 1; Call Cell;
        Return
        n = 0; corners[] = {};
        For y In {0:1}
          Call Twice;
        EndFor
        Line(1) = {corners[0], corners[1]}; Printf("%g points, the first is %g", #corners[], corners[0]);""",
    "lists": SQUARE
    + """
        x[] = {0, 0.5 : 2 : 0.5, 3}; x[] += {4}; x[] -= {0}; x[2] = 7; x[#x[] - 1] *= 2; y = x[1] ? 1 : 2;
        z() = LinSpace(0, 1, 5); w[] = x[{0, 1}]; n = #x(); v = Fabs(-2) + Hypot(3, 4)^2 + Max(1, 2) - Fmod(7, 2);
        k = 0; k++; k--; k /= 2; found = Find(x[], {1, 2}); q = Exists(k) && !(k >= 1) || k != 3; u[] = Unique(x[]);
        xyz[] = Point{1}; Point(20) = {xyz[0], xyz[1] + 1e-3, .5E+1}; x[0]++;""",
    "names": SQUARE
    + """
        For i In {1:4}
          Physical Curve(Sprintf("side %g", i)) = {i};
        EndFor
        Physical Curve("alle Seiten: Süd/Ost (1)") = {1, 2}; Physical Surface('quoted') = {1};
        Physical Curve("L'Aquila") = {3}; Printf("New surfaces '%g' and '%g'", 1, 2);
        c() = Physical Curve{1, 2}; Physical Point("corner") += {1};""",
    "comments": '/* For a start: "If it is /* one, it ends" */\n'
    + SQUARE
    + '// SystemCall "no"; Else\n/**/ /***/ k = 1; // "\nIf (k) /* EndIf */ k = 2; EndIf\n',
    "branches": SQUARE
    + """
        kind = 2;
        If (kind == 1)
          Recombine Surface{1};
        ElseIf (kind == 2 && h < 1)
          For i In {1:4:2}
            If (i == 3) Transfinite Curve{i} = 5; EndIf
          EndFor
        Else
          Error("no such kind: %f", kind);
        EndIf
        For (1:3)
          h *= 0.9;
        EndFor""",
    "quads": SQUARE
    + """
        Transfinite Curve "*" = 5; Transfinite Surface "*"; Recombine Surface "*"; Recombine Surface{1} = 30;
        Mesh.RecombineAll = 1; Mesh.SubdivisionAlgorithm = 1; Mesh.Smoothing += 2; Smoother Surface{1} = 3;
        Mesh.MshFileVersion = 2.2; Geometry.Tolerance = 1e-9; Mesh.Color.Lines = {1, 2, 3}; x = Mesh.MeshSizeMax;
        MeshAlgorithm Surface{1} = 8; Mesh 2;""",
    "volumes": """
        SetFactory("Built-in"); Surface Loop(1) = {1:6}; Volume(1) = {1}; Surface(7) = {3} In Sphere {1};
        Ruled Surface(8) = {4}; Line Loop(9) = {1, -2}; Compound Curve{1, 2}; Reverse Surface{8};
        SetFactory("OpenCASCADE"); Box(2) = {0, 0, 0, 1, 1, 1}; Sphere(3) = {0, 0, 0, 1}; Cylinder(4) = {0, 0, 0, 0, 0, 1, 1};
        Cone(5) = {0, 0, 0, 1, 0, 0, 1, 0}; Wedge(6) = {0, 0, 0, 1, 1, 1}; Torus(7) = {0, 0, 0, 2, 1};
        Wire(1) = {1}; ThruSections(9) = {1:3}; Fillet{1}{2}{0.1} Extrude { Surface{1}; } Using Wire {1}""",
    "loops of no rounds": "For i In {1e7:1}\nx = i;\nEndFor\nFor (0:3e6:-1)\nEndFor\nFor i In {3e6:0:1}\nEndFor\n",
    "a number called inf": "inf = 2;\nFor i In {0:inf}\nEndFor\n",
    "windows": "x = 1;\r\n// one\r\nFor i In {0:1}\r\n  x += i;\r\nEndFor\r\n",
    "boundary layer": SQUARE
    + """
        Field[1] = BoundaryLayer; Field[1].EdgesList = {1}; Field[1].hwall_n = 0.01; Field[1].ratio = 1.2;
        BoundaryLayer Field = 1; RefineMesh; Split Curve {1} Point {2}; m[] = BoundingBox Surface{1};""",
}  # fmt: skip


def write(tmp_path, text, name="a.geo"):
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("path", sorted(MESHES.rglob("*.geo")), ids=lambda path: path.relative_to(MESHES).as_posix())
def test_the_meshes_of_the_project_pass(path):
    assert next(iter(check_geo(path).texts.values())).count(";") >= 2


@pytest.mark.parametrize("name", ORDINARY)
def test_ordinary_geometry_passes(tmp_path, name):
    path = write(tmp_path, ORDINARY[name])
    (text,) = check_geo(path).texts.values()
    lines = ORDINARY[name].replace("\r", "").splitlines()
    for given, line in zip(text.splitlines(), lines, strict=False):  # an error of Gmsh names the line of the file
        assert re.findall(r"\w+", given)[:1] == re.findall(r"\w+", re.sub(r"//.*|/\*.*?\*/", "", line))[:1]


REFUSED = [
    'SystemCall "id > out";', 'NonBlockingSystemCall "id";', 'System "id";', 'OnelabRun("a", "id");', "Exit;", "Abort;",
    'Printf("written") > "out";', 'Printf("%g", 1) >> "out";', 'Printf("%n%s");', 'Printf("%s", 1);', 'Error("%n");',
    'Printf("%.99999f", 1);', 'Printf("%%n", 1);', 'a = "%n"; Printf(a);', 'Save "out.msh";', 'Print "out.png";',
    'Print Sprintf("out.%g", 1);', 'Merge "other.geo";', 'MergeWithBoundingBox "other";', 'Open "other.geo";',
    'CreateDir "out";', 'ShapeFromFile("a.step");', 'a() = ShapeFromFile("a.step");', 'x[] = ListFromFile("/etc/passwd");',
    'Include "/etc/passwd";', 'Include "../b.geo";', 'Include "~/b.geo";', 'Include Str("b.geo");', "Include b;",
    'Include "a.geo";', 'Include "b/../../b.geo";', 'Include "C:/b.geo";',
    'Plugin(MathEval).Run;', 'Plugin(NewView).Name = "a";', 'View "a" { SP(0,0,0){1}; };', 'Save View[0] "out";',
    'General.ErrorFileName = "out";', "General.AbortOnError = 1;", 'General.BackgroundImageFileName = "a";', "General.Color;",
    "General.ExecutableFileName += 1;", "General.Trackball", "x = General.Trackball;", "General.Color.Text.x = 1;",
    'Solver.Executable0 = "id";', "Solver.AutoCheck = 1;",
    'Solver.Name0 = "id";', 'PostProcessing.Format = 1;', 'Mesh.Format = "a";', 'Geometry.DoubleClickedPointCommand = "id";',
    'Mesh = "a";', "Print.Format = 1;", "Mesh.Save;", "Mesh[1].Save = 1;",
    'Field[1] = Structured;', 'Field[1] = PostView;', 'Field[1] = ExternalProcess;', 'Field[1] = Octree;',
    'Field[1].FileName = "a";', 'Field[1].CommandLine = "id";', 'Field[1].F = "x; id";', "Field[1].TestLoad;",
    'Field[1].F = Sprintf("x; %g", 1);', 'Field[1].F = Sprintf("%s", 1);', 'Field[1].F = Sprintf("%g");', 'Field[1].F = "%g";',
    'Field[1].FileName = Sprintf("a%g", 1);', 'Field[1].F = Sprintf("%g", 1) + "x";', 'Field[1].F = a, Sprintf("%g", 1);',
    'Field[1].F = Str("x");', 'Field[1] = S2N["Structured"];', "Field[1] = MathEval; Field[2] = a~{1};",
    'S2N["SystemCall"] "id";', 'StringToName["Save"] "out";', 'N2S[a] "id";', 'x = GetEnv("HOME");', 'x = FileExists("a");',
    'x = GetValue("a", 1);', 'x = GetNumber("a");', 'x = GetString("a");', 'Physical Curve(GetEnv("HOME")) = {1};',
    'Physical Curve(CurrentDirectory) = {1};', 'Physical Curve(StrCat("a", "b")) = {1};', 'SetNumber("a", 1);',
    'SetName "a";', "Sleep 100;", "Merge a;", "Draw;", "NewModel;", "CreateTopology;", 'OptimizeMesh "Netgen";', "Delete All;",
    "Delete Options;", "PartitionMesh 4;", 'Call "Cell";', 'Call Str("Cell");', "Parse a;", "Unheard 3;", "Unheard;",
    'Unheard "a";', "x = Unheard[\"a\"];", 'a = "text";', 'a[] = Str("b", "c");', 'DefineConstant[ a = "text" ];',
    'DefineConstant[ a = {"text", Name "b"} ];', 'DefineConstant[ a = {1, SystemCall "id"} ];',
    'DefineConstant[ a = {1, GmshOption "ResetDatabase"} ];', 'DefineConstant[ a = {1, Kind "file"} ];',
    'DefineConstant[ a = {1, Macro "GmshMergeFile"} ];', 'x = DefineString["a"];', "Struct S [ a 1 ];", "x = S::a;",
    'SetFactory("Other");', 'SetFactory(Str("OpenCASCADE"));', 'Parametric Surface(1) = "x" "y" "z";', 'Hide "a";',
    'Transfinite Curve "a" = 3;', 'x = Cpu;', 'TextAttributes("Font", "a");', 'Slide({1}, "a", "b");', "x.y = 1;",
    "x = y.z;", "x[-1]++ ++;", "y = x[-5]++;", "y = x(0)--;", "x[{1, -7}] = {1, 2};", "x[i++] = 1;", "x[y[1]++] = 2;",
    "EndFor", "EndIf", "Else", "Return", "If (1)\nx = 1;", "For i In {0:1}\nIf (1)\nEndFor\nEndIf",
    "For i In {0:1} x = 1; EndFor", "For i In {0:9}\nEndFor x = 1;", "Macro M x = 1;\nReturn", "Macro M\nx = 1; Return x = 2;",
    "If (1)\nMacro M\nReturn\nEndIf", "Macro M\nReturn\nMacro M\nReturn", "Macro M\nCall M;\nReturn",
    "".join(f"Macro M{i}\nCall M{i + 1};\nReturn\n" for i in range(3000)),
    "Macro M\nCall N;\nReturn\nMacro N\nIf (1)\nCall M;\nEndIf\nReturn", 'Macro "M"\nReturn', "Call M; x = 1;",
    "If (1)\nElse\nElse\nEndIf", "x = 1 Else 2;", "x1If = 1;", "x = y2EndIf;", "If (1)\n" * 60 + "EndIf\n" * 60,
    'Physical Curve("EndIf SystemCall") = {1};', "x = 1e5SystemCall;", "x = 1.2.3;", "x = 0x10;", f"{'a' * 70} = 1;",
    f"x = {'1' * 70};", f'Physical Curve("{"a" * 300}") = {{1}};', f'Printf("{"a" * 300}");', "x" + "~{1}" * 20 + " = 1;",
    'Physical Curve("a\\") = {1};', 'Physical Curve("a\nb") = {1};', "Physical Curve('a\"b') = {1};", 'Physical Curve("a',
    "/* no end", "x = 1; /* /", "x = $1;", "x = `id`;", "x = 1 \\\n + 2;", "#include <a>", "#! /bin/sh", "x = ü;", "x\0 = 1;",
    "x = 1;\rSystemCall = 2;", "// a comment\rx = 1;", "x = 1;\x1a", "x\u200b = 1;", 'x = 1;\x0bSave "a";',
    "For i In {0:18446744073709551616}\nEndFor", "For (1:1e999)\nEndFor", "For i In {0:1:1e-9}\nEndFor",
    "For i In {0:-2000000:-1}\nEndFor", "For i In {0:1:0}\nEndFor",
    "{ x = 1; }", "Delete { y; x[-5] = 1; }", "Delete { y; Field[1] = Octree; }", "SyncModel[-5] = 1;", "Parent(-1) = 2;",
    "Delete { y; x[-5]++; }", "Physical Surface{" + '"a", ' * 300 + '"b"};',"1 = 2;", '"a" = 2;', "x = (1;)", "x = 1)); Exit;",
]  # fmt: skip


@pytest.mark.parametrize("text", REFUSED)
def test_what_makes_no_geometry_is_refused(tmp_path, text):
    write(tmp_path, "x = 1;\n", "b.geo")
    path = write(tmp_path, "y = 1;\n" + text + "\n", "inside/a.geo")
    write(tmp_path, "x = 1;\n", "inside/b/c.geo")
    with pytest.raises(
        InputError, match=r"a\.geo: (line \d|macro \w+: (calls itself|more than)|inside)?.*--trust"
    ) as caught:
        check_geo(path)
    assert len(str(caught.value)) < 700 and "\n" not in str(caught.value)


def test_a_file_of_too_many_words_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(geo_tokens, "MOST_TOKENS", 100)
    with pytest.raises(InputError, match=r"a\.geo: line 26: more than 100 words, numbers and marks; .*--trust"):
        check_geo(write(tmp_path, "x = 1;\n" * 30))


def test_the_line_names_file_line_statement_and_remedy(tmp_path):
    write(tmp_path, "\n\n" + 'SystemCall "id";\n', "part.geo")
    path = write(tmp_path, 'x = 1;\nInclude "part.geo";\n')
    with pytest.raises(InputError, match=r'part\.geo: line 3: SystemCall "id";: .* --trust \(trust=True in Python\)'):
        check_geo(path)


def test_gmsh_is_given_the_checked_text_only(tmp_path):
    path = write(tmp_path, SQUARE + '// SystemCall "id";\n/* Save "out"; */ x[y] = 2;\n')
    (text,) = check_geo(path).texts.values()
    assert "SystemCall" not in text and "Save" not in text and "x[ Min(Max(0, y), 10000000)" in text


def test_options_of_the_window_are_passed_over(tmp_path):
    look = """
        General.Trackball = 0; General.RotationX = 270; General.Color.Background = White; General.GraphicsFont = "Sans";
        General.Axes = 2; General.Color.Text = {0, 0, 0}; General.Trackball = 1; General.SmallAxes += 1; Mesh.SurfaceEdges = 0;
        Geometry.PointNumbers = 1; Geometry.Color.Points = {1, 2, 3}; If (h > 1) General.AxesFormatX = "%s"; EndIf"""
    path = write(tmp_path, SQUARE + look + "\n")
    checked = check_geo(path)
    assert "General" not in "".join(checked.texts.values()) and "Mesh.SurfaceEdges" in "".join(checked.texts.values())
    (note,) = read_mesh(path, ()).notes
    first = (
        "General.Trackball, General.RotationX, General.Color.Background, General.GraphicsFont, General.Axes and 3 more"
    )
    assert bare(note) == f"{path}: options of Gmsh's window are passed over: {first}"
    assert not read_mesh(write(tmp_path, SQUARE, "b.geo"), ()).notes


def test_a_remainder_of_a_division_by_zero_names_its_line(tmp_path):
    path = write(tmp_path, "n = 4 % 3;\nm = n - 1;\n" + SQUARE + "k = 5 % m;\n")
    with pytest.raises(
        InputError, match=r"a\.geo: line 1, .*a\.geo: line 9: Gmsh .* after % stands 0; correct the file$"
    ):
        read_mesh(path, ())


def test_files_are_included_from_the_folder_only(tmp_path):
    write(tmp_path, 'Include "../c.geo";\nh = 0.3;\n', "scene/parts/b.geo")
    write(tmp_path, "k = 1;\n", "scene/c.geo")
    path = write(tmp_path, 'Include "parts/b.geo";\nFor i In {0:2}\nInclude "c.geo";\nEndFor\n', "scene/a.geo")
    found = check_geo(path)
    assert [source.name for source in found.sources.values()] == ["a.geo", "b.geo", "c.geo"]
    assert all("/" not in name for name in found.texts)
    assert all(f'"{name}"' in "".join(found.texts.values()) for name in list(found.texts)[1:])
    with pytest.raises(InputError, match=r"Include .*lies outside of the folder"):
        check_geo(tmp_path / "scene" / "parts" / "b.geo")
    (tmp_path / "scene" / "link.geo").symlink_to("/etc/hostname")
    with pytest.raises(InputError, match="outside"):
        check_geo(write(tmp_path, 'Include "link.geo";\n', "scene/d.geo"))
    for depth in range(DEEPEST + 2):
        write(tmp_path, f'Include "{depth + 1}.geo";\n', f"scene/{depth}.geo")
    write(tmp_path, "", f"scene/{DEEPEST + 2}.geo")
    with pytest.raises(InputError, match=r"includes itself|more than"):
        check_geo(tmp_path / "scene" / "0.geo")


def test_a_place_before_a_list_is_an_error_of_gmsh(tmp_path):
    for place, fault in (("1 - 3", True), ("1e12*#x[]", True), ("#x[]", False)):
        text = SQUARE + f'x[] = {{1, 2}};\nx[{place}] = 3;\nPrintf("%f", x[2 - 2]);\n'
        path = write(tmp_path, text)
        if fault:
            with pytest.raises(InputError, match=r"a\.geo: Gmsh: '.*/a\.geo', line \d+: Division by zero"):
                read_mesh(path, ())
        else:
            assert read_mesh(path, ()).rocks == ("rock",)

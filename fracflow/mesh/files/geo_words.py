"""Words of Gmsh's language: which statements a .geo from a stranger may have, and which words it may not have anywhere."""

from __future__ import annotations

import re

ENTITIES = frozenset("Point Line Curve Surface Volume".split())
BLOCKS = frozenset("If ElseIf Else EndIf For EndFor Macro Function Return".split())

# Keywords that begin a statement which makes, changes or meshes a geometry, and does nothing else.
HEADS = ENTITIES | frozenset(
    """
    Circle Ellipse Ellipsis Spline BSpline CatmullRom Bezier Nurbs Wire Compound Plane Ruled Parent
    Sphere Box Block Torus Rectangle Disk Cylinder Cone Wedge ThruSections Physical
    Translate Rotate Symmetry Dilate Affine Intersect Split Delete Recursive Color Show Hide Extrude
    BooleanUnion BooleanFuse BooleanIntersection BooleanCommon BooleanDifference BooleanCut
    BooleanFragments BooleanCoherence BooleanSection Fillet Chamfer
    MeshSize Characteristic Transfinite TransfQuadTri MeshAlgorithm MeshSizeFromBoundary Recombine Smoother
    Periodic Reverse ReverseMesh Degenerated Coherence HealShapes RefineMesh RecombineMesh SyncModel SetMaxTag
    BoundingBox DefineConstant SetFactory Printf Error Warning Field
    """.split()
)
# Those of them that are followed by a place in round brackets; all other names so followed are lists.
PLACED = frozenset(
    """
    Point Line Curve Circle Ellipse Ellipsis Spline BSpline CatmullRom Bezier Nurbs Wire Surface Volume
    Sphere Box Block Torus Rectangle Disk Cylinder Cone Wedge ThruSections SetFactory Printf Error Warning
    BooleanUnion BooleanFuse BooleanIntersection BooleanCommon BooleanDifference BooleanCut
    BooleanFragments BooleanCoherence
    """.split()
)
# Some end with a brace, without a semicolon.
BRACED = frozenset(
    """
    Translate Rotate Symmetry Dilate Affine Delete Recursive Color Show Hide Extrude Intersect ThruSections Ruled
    BooleanUnion BooleanFuse BooleanIntersection BooleanCommon BooleanDifference BooleanCut
    BooleanFragments BooleanCoherence BooleanSection Fillet Chamfer
    Duplicata Boundary CombinedBoundary OrientedBoundary OrientedCombinedBoundary PointsOf
    """.split()
)
ACTIONS = BRACED - HEADS  # plain words to Gmsh's lexer, which take shapes in braces
SAYING = frozenset("Printf Error Warning".split())
OPTIONS = frozenset("Mesh Geometry".split())  # numbers only; no other group of options can be set
# Options of General that only say what Gmsh's window looks like, which the window itself saves: passed over, not given to Gmsh.
WINDOW = re.compile(
    r"""(?:(?:Small)?Axes\w* | Alpha\w* | Arrow\w* | BackgroundGradient | Camera\w* | Clip\w* | Color\.\w+ | ColorScheme
      | DetachedMenu | Display\w* | DoubleBuffer | Draw\w+ | FastRedraw | \w*FontSize | Graphics\w+ | HighResolution\w*
      | \w*Position[XY]? | Light\d?\w* | MaxX | MaxY | MaxZ | MinX | MinY | MinZ | Mouse\w+ | Orthographic | PolygonOffset\w*
      | QuadricSubdivisions | Rotation\w+ | Scale[XYZ] | Shininess\w* | Stereo | Tooltips | Trackball\w* | Translation[XYZ]
      | VectorType | \w+(?:Width|Height) | ZoomFactor)""",
    re.VERBOSE,
)
FIELDS = frozenset(
    """
    Attractor AttractorAnisoCurve Ball BoundaryLayer Box Constant Curvature Cylinder Distance Extend Frustum Gradient
    IntersectAniso Laplacian MathEval MathEvalAniso Max MaxEigenHessian Mean Min MinAniso Restrict Threshold
    """.split()
)
FORMULAS = re.compile(r"F|[mM][123][123]")  # options of fields that hold a formula
FORMULA = re.compile(r"[A-Za-z0-9_ .,+\-*/^()<>]*")
FACTORIES = frozenset(("OpenCASCADE", "Built-in"))
LABELS = frozenset("Name Label Help ShortHelp Units Highlight".split())  # of a constant, all of them texts
EVERYTHING = frozenset(("*", "all"))
NAMES_ALL = ENTITIES | frozenset("Show Hide MeshSize Length TransfQuadTri".split())  # before "*"

# Words that run programs, read or write files, make texts that could name files, look at the machine, or need a window.
REFUSED = frozenset(
    """
    System SystemCall NonBlockingSystemCall OnelabRun OnelabAction Save Print Merge MergeWithBoundingBox Open
    CreateDir ShapeFromFile ListFromFile FileExists Plugin View Alias AliasWithOptions CopyOptions Combine
    SetName SetNumber SetString SetTag SetPartition PartitionMesh CreateOverlaps SendToServer Sleep Exit Abort Draw
    OptimizeMesh AdaptMesh TransformMesh RelocateMesh ReorientMesh SetOrder Remesh SetChanged NewModel Slide
    CreateTopology CreateGeometry ClassifySurfaces CreateMeshEdges CreateMeshFaces Homology Cohomology Betti
    RenumberMeshNodes RenumberMeshElements SetCurrentWindow SplitCurrentWindowHorizontal SplitCurrentWindowVertical
    UnsplitWindow General Solver PostProcessing FontSize ColorTable TextAttributes INTERPOLATION_SCHEME T2 T3 TIME
    Str StrCat StrChoice StrCmp StrFind StrLen StrPrefix StrRelative StrReplace StrSub UpperCase LowerCase
    LowerCaseIn StringToName S2N NameToString N2S GetEnv GetString GetStringValue GetForcedStr GetNumber GetValue
    CurrentDir CurrentDirectory CurrentFileName AbsolutePath DirName FixRelativePath GmshExecutableName CodeName Today
    DefineString Struct DefineStruct NameStruct DimNameSpace Append UndefineConstant Cpu Memory TotalMemory MPI_Rank
    MPI_Size Catenary PolarSphere Levelset ExternalProcess PostView Structured Parse Python Lua GmshOption
    """.split()
)

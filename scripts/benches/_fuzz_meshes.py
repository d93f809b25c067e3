"""Meshes and geometries out of order: .msh 2.2 and 4.1, as text and binary, and .geo with statements that do harm."""

from __future__ import annotations

import random
import re
import struct
from pathlib import Path

import _fuzz_damage as damage
from _fuzz_scenes import MESHES

FORMATS = (("2.2", False), ("2.2", True), ("4.1", False), ("4.1", True))
SOURCES = ("report_5_2/block.geo", "report_5_3/fault.geo", "failures/pinched_fracture/pinched.geo")
OF_SCENE = {name: f"{Path(name).parent}/scene.toml" for name in SOURCES}
INTEGERS = (0, 1, 2, 3, 15, -1, 7, 99, 10**6, 2**31 - 1, -(2**31), 92)
DOUBLES = (float("nan"), float("inf"), 1e308, -1e308, 1e-320, 0.0, -1.0, 1.0)
SECTIONS = (
    b"$Comments\nx\n$EndComments\n", b"$Periodic\n1\n0 1 2\n1\n1 2\n$EndPeriodic\n",
    b"$NodeData\n1\n\"x\"\n$EndNodeData\n",
    b"$PartitionedEntities\n9\n$EndPartitionedEntities\n", b"$InterpolationScheme\n", b"$Parametrizations\n99 99\n",
    b"$ElementData\n1\n\"v\"\n1\n0.0\n3\n0\n1\n1000000000\n1 1\n$EndElementData\n",
    b"$Entities\n1 0 0 0\n$EndEntities\n",
)  # fmt: skip
HARM = (  # each would leave a mark that is looked for, or end elsewhere
    'SystemCall "touch {hit}";', 'SystemCall("touch {hit}");', 'System "touch {hit}";',
    'NonBlockingSystemCall "touch {hit}";',
    'Printf("x") > "{hit}";', 'Printf("%g", 1) >> "{hit}";', 'Error("x") > "{hit}";', 'Save "{hit}.msh";',
    'Print "{hit}.msh";',
    'Print "{hit}.png";', 'Save View[0] "{hit}.pos";', 'Include "{out}/danger.geo";', 'Merge "{out}/danger.geo";',
    'Include "../danger.geo";', 'Include StrCat("{out}", "/danger.geo");', 'MergeFile "{out}/danger.geo";',
    'Field[1] = ExternalProcess; Field[1].CommandLine = "touch {hit}"; Background Field = 1;',
    'OnelabRun("x", "touch {hit}");',
    'Field[1] = Structured; Field[1].FileName = "/dev/zero"; Background Field = 1;', 'Merge "/dev/zero";',
    'Solver.Executable0 = "touch {hit}";', 'General.ErrorFileName = "{hit}";', 'General.FileName = "{hit}";',
    "Exit;", "Abort;",
    'Plugin(MathEval).Run; Plugin(Bubbles).OutputFile = "{hit}"; Plugin(Bubbles).Run;',
    'x = GetString("x"); y = GetValue("x", 1);',
    "l() = ListFromFile('/etc/passwd');", 'DefineConstant[ m = {{1, Name "a", Macro "x", ServerAction "Reset"}} ];',
    "General.SaveOptions = 1; Mesh.SaveAll = 1;", 'PostProcessing.SaveMesh = 1; Save Background Mesh "{hit}";',
    'General.OptionsFileName = "{hit}"; General.SaveSession = 1; General.SessionFileName = "{hit}";',
    'CreateDir "{hit}";',
    'SyncModel; Draw; Combine ElementsByViewName; View "x" {{ SP(0,0,0){{1}}; }}; Save View[0] "{hit}";',
    "UnsplitWindow;",
    'ShapeFromFile("{out}/canary");', 's = GetEnv("HOME"); Printf(s) > "{hit}";',
    'Parse "SystemCall ""touch {hit}"";";',
    'DefineString[ f = {{"x", Kind "file", Name "f"}} ]; Include f;', 'f = "{out}/danger.geo"; Include Str(f);',
    'Coherence Mesh; RelocateMesh Surface {{1}}; Save "{hit}";', 'Mesh 2; Save "{hit}.msh";',
    'Cpu; Memory; Save "{hit}";',
)  # fmt: skip
WRAPS = (
    "{0}\n", "{0}\n", "{0}\n", "/* x */ {0}\n", "/* */{0}/* */\n", "// x\r{0}\n", "// x \\\n{0}\n",
    "If (1)\n{0}\nEndIf\n", "If (0) Else\n{0}\nEndIf\n",
    "For i In {{1:1}}\n{0}\nEndFor\n", "Macro zz\n{0}\nReturn\nCall zz;\n", "Function zz\n{0}\nReturn\nCall zz;\n",
    "a = 1; {0}\n",
    'a = "x"; {0} b = "y";\n', 'a = "\\"; {0} b = "";\n', "a = 'x'; {0}\n", "a = '\"'; {0} b = '\"';\n",
    'Str("a"); {0}\n', "\x0c{0}\n", "\x0b{0}\n",
    "//\x00\n{0}\n", "\ufeff{0}\n", "/**/ {0}\n", "/*/ {0} /*/\n{0}\n", "// {0}\n", "/* {0} */\n", 'x = "{0}";\n',
    "If (0)\n/* EndIf */\nEndIf\n{0}\n",
    "If (0)\n\"EndIf\"\n{0}\nEndIf\n", "If (0)\n// EndIf\n{0}\nEndIf {0}\n", "#\n{0}\n", "\\\n{0}\n",
    "a = #{{1}};\n{0}\n", ";;{0};\n", "}} {0}\n", "{{ {0} }}\n",
    "Physical Surface(\"x\") = {{1}}; {0}\n", "For k In {{0:0}} {0} EndFor\n", "If (1 == 1 || 0) {0} EndIf\n",
    "Return {0}\n", "EndFor {0}\n", "EndIf {0}\n",
)  # fmt: skip
TOKEN = re.compile(r'"[^"\n]*"|//[^\n]*|/\*.*?\*/|[A-Za-z_]\w*|[\d.]+(?:[eE][-+]?\d+)?|\s+|.', re.S)
WORDS = (
    "Point", "Line", "Curve", "Surface", "Volume", "Physical", "Transfinite", "Recombine", "Loop", "Plane", "For",
    "EndFor", "If",
    "EndIf", "Else", "In", "Macro", "Call", "Return", "Include", "DefineConstant", "Field", "Extrude", "Rotate",
    "BooleanUnion",
    "SetFactory", "Disk", "Rectangle", "Embed", "Delete", "Sqrt", "Rand", "Sprintf", "Str", "newp", "Mesh",
    "General", "Geometry",
    "(", ")", "{", "}", "[", "]", ";", ",", "=", "+=", "-", "/", "*", "^", "%", "!", "?", ":", "::", "#", "~", "@",
    "'", '"', "\\", "$", "\x00",
)  # fmt: skip
NUMBERS = (
    "0",
    "-1",
    "1e308",
    "1e-320",
    "1e999",
    "nan",
    "99999999",
    "2147483648",
    "-2147483649",
    "9" * 400,
    "1e9",
    "0x10",
    ".",
    "1..2",
    "10000",
)


def geometries() -> list[tuple[str, bytes]]:
    """Name and text of every .geo of the repository."""
    return [(str(path.relative_to(MESHES)), path.read_bytes()) for path in sorted(MESHES.rglob("*.geo"))]


def meshed(source: str, version: str, binary: bool, path: Path) -> None:
    """Let Gmsh mesh a geometry and write it to a file. In a process of its own: Gmsh keeps what it was told."""
    import gmsh

    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(MESHES / source))
    gmsh.model.mesh.generate(2)
    gmsh.option.setNumber("Mesh.MshFileVersion", float(version))
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(path))
    gmsh.finalize()


def _section(data: bytes, name: bytes) -> tuple[int, int]:
    """Where the inside of a section begins and ends; all of the file where it has none."""
    start, end = data.find(b"$" + name + b"\n"), data.find(b"$End" + name)
    return (start + len(name) + 2, end) if 0 <= start < end else (0, len(data))


def _row(r: random.Random, data: bytes) -> bytes:
    """Words of one row of a section replaced: node numbers, tags, types, counts, coordinates."""
    start, end = _section(
        data, r.choice((b"Nodes", b"Nodes", b"Elements", b"Elements", b"PhysicalNames", b"Entities", b"MeshFormat"))
    )
    rows = data[start:end].split(b"\n")
    for _ in range(r.choice((1, 1, 3))):
        at = 0 if r.random() < 0.2 else r.randrange(len(rows))
        words = rows[at].split()
        if words:
            what = r.random()
            if what < 0.7:
                words[r.randrange(len(words))] = r.choice(damage.NUMBERS).encode()
            elif what < 0.85:
                words += words[-1:] * r.choice((1, 2, 40))
            else:
                words.pop()
            rows[at] = b" ".join(words)
    return data[:start] + b"\n".join(rows) + data[end:]


def _same_node(r: random.Random, data: bytes) -> bytes:
    """Two nodes at one place, with one number, or both."""
    start, end = _section(data, b"Nodes")
    rows = data[start:end].split(b"\n")
    here, there = r.randrange(len(rows)), r.randrange(len(rows))
    one, other = rows[here].split(), rows[there].split()
    rows[here] = b" ".join([*one[:1], *other[1:]] if r.random() < 0.5 else [*other[:1], *one[1:]])
    return data[:start] + b"\n".join(rows) + data[end:]


def _without(r: random.Random, data: bytes) -> bytes:
    """A section left out, doubled, moved to the end, or a strange one put in."""
    names = re.findall(rb"^\$((?!End)\w+)\r?$", data, re.M)
    if not names:
        return data
    name = r.choice(names)
    start, end = _section(data, name)
    start, end = start - len(name) - 2, end + len(name) + 5
    what = r.random()
    if what < 0.4:
        return data[:start] + data[end:]
    if what < 0.6:
        return data[:end] + data[start:]
    if what < 0.75:
        return data[:start] + data[end:] + data[start:end]
    return data[:start] + r.choice(SECTIONS) + data[start:]


def _groups(r: random.Random, data: bytes) -> bytes:
    """Physical groups renamed, renumbered, in other dimensions, or twice."""
    start, end = _section(data, b"PhysicalNames")
    rows = data[start:end].split(b"\n")
    at = r.randrange(len(rows))
    names = (
        b'""',
        b'"x',
        b'"\xff"',
        b'"a\x1b[31m"',
        b'"default"',
        b'"' + b"x" * 5000 + b'"',
        b"x",
        b'"../../x"',
        b'"a b"',
        b'"rock"',
        b'"west"',
    )
    rows[at] = b"%d %d %b" % (r.choice((0, 1, 2, 3, -1)), r.choice((0, 1, 2, 3, 99, -5)), r.choice(names))
    return data[:start] + b"\n".join(rows) + data[end:]


def _integer(r: random.Random, data: bytes) -> bytes:
    """A 4- or 8-byte number of the binary part replaced."""
    start, end = _section(data, r.choice((b"Nodes", b"Elements", b"Elements", b"Entities")))
    wide = r.random() < 0.5
    where = start + damage.place(r, max(end - start - 8, 1))
    number = r.choice((*INTEGERS, *((2**63 - 1, 2**40) if wide else ())))
    return data[:where] + struct.pack("<q" if wide else "<i", number) + data[where + (8 if wide else 4) :]


def _double(r: random.Random, data: bytes) -> bytes:
    """A coordinate of the binary part replaced."""
    start, end = _section(data, b"Nodes")
    where = start + r.randrange(max(end - start - 8, 1))
    return data[:where] + struct.pack("<d", r.choice(DOUBLES)) + data[where + 8 :]


def _head(r: random.Random, data: bytes) -> bytes:
    """Another version, size of numbers, order of bytes; or something before the first line."""
    heads = (
        b"2.2 0 8", b"2.2 1 8", b"4.1 0 8", b"4.1 1 8", b"4 0 8", b"4.0 1 8", b"2 0 8", b"1 0 8",
        b"3 0 8", b"2.2 0 4", b"4.1 1 4",
        b"9.9 9 9", b"4.1 2 8", b"", b"-2 0 8", b"2.2 1 8\n\x00\x00\x00\x01", b"2.2 1 8\n\x01\x00\x00\x00", b"nan 0 8",
        b"4.1 0 8 9 9",
    )  # fmt: skip
    if r.random() < 0.25:
        return (
            r.choice(
                (b"\n", b"// x\n", b"\xef\xbb\xbf", b" ", b"Point(1) = {0, 0, 0};\n", b"$Comments\n", b"\r\n", b"\x00")
            )
            + data
        )
    start, end = _section(data, b"MeshFormat")
    inside = data[start:end].partition(b"\n")[2]
    return data[:start] + r.choice(heads) + b"\n" + (inside if r.random() < 0.7 else b"") + data[end:]


def draw_msh(r: random.Random, base: bytes, binary: bool) -> tuple[bytes, str]:
    """A mesh file out of order, and how that was made."""
    own = (_integer, _integer, _double, *damage.BYTES) if binary else (_row, _row, _row, _same_node, *damage.TEXT)
    return damage.damaged(r, base, (*own, _head, _without, _groups))


def _tokens(r: random.Random, data: bytes) -> bytes:
    """Words of a geometry replaced, left out, doubled or put in."""
    found = TOKEN.findall(data.decode("utf-8", "replace"))
    for _ in range(r.choice((1, 1, 2, 4))):
        at, what = r.randrange(len(found)), r.random()
        if what < 0.35:
            found[at] = r.choice(NUMBERS) if found[at][:1].isdigit() else r.choice(WORDS)
        elif what < 0.55 and len(found) > 1:
            del found[at]
        elif what < 0.75:
            found.insert(at, r.choice(found))
        else:
            found.insert(at, r.choice(WORDS))
    return "".join(found).encode("utf-8")


def draw_geo(r: random.Random, hit: Path, outside: Path) -> tuple[str, bytes, bytes, str]:
    """Name of a geometry, its text, the same out of order or with harm in it, and how that was made."""
    name, text = r.choice(geometries())
    new, how = text, ""
    if r.random() < 0.6:
        harm = r.choice(HARM).format(hit=hit, out=outside)
        put_in = r.choice(WRAPS).format(harm)
        rows = text.decode().splitlines(keepends=True)
        rows.insert(r.choice((0, len(rows), r.randrange(len(rows) + 1))), put_in)
        new, how = "".join(rows).encode(), "harm"
    if not how or r.random() < 0.3:
        new, more = damage.damaged(r, new, (*damage.TEXT, _tokens, _tokens, _tokens, _tokens))
        how = f"{how}+{more}".strip("+")
    return name, text, new, how

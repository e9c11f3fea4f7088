"""USD scenes: what USD's own reader makes of them is never trusted, and where it falls over another process does."""

from __future__ import annotations

import base64
import io
import struct
import zipfile
import zlib

from cases.hostile.rows import SCENE, Row

HEAD = '#usda 1.0\n(\n    upAxis = "Y"\n    metersPerUnit = 0.001\n    timeCodesPerSecond = 24\n)\n'
MESH = """def Mesh "ground"
{
    point3f[] points = [(-100, 0, -100), (-100, 0, 100), (100, 0, 100), (100, 0, -100)]
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
}
"""
GOOD = HEAD + MESH


def usd(
    name: str,
    text: str | bytes,
    verdict: str = "",
    words: str = "",
    prim: str = "/ground",
    file: str = "set.usda",
    frames: int = 0,
) -> Row:
    data = text.encode() if isinstance(text, str) else text
    scene = SCENE.replace(b"{mesh: ground.ply}", f"{{usd: {file}, prim: {prim}}}".encode())
    return Row(name, verdict, words, {"scene.yaml": scene, file: data}, frames=frames)


def within(inner: str) -> str:
    """The mesh below a prim with more in it."""
    return HEAD + 'def Xform "set"\n{\n' + inner + "\n" + MESH + "}\n"


def placed(row: str) -> str:
    """A transform with these first three rows."""
    rows = ", ".join([f"({row})"] * 3)
    return f'matrix4d xformOp:transform = ({rows}, (0, 0, 0, 1))\nuniform token[] xformOpOrder = ["xformOp:transform"]'


def refers(name: str, target: str) -> str:
    return f'def "{name}" (\nreferences = {target}\n)\n{{\n}}\n'


def chain(count: int, twice: bool = False, instanced: bool = False) -> str:
    """Each prim refers to the one before, once or twice: as deep as it is long, or as many as 2 to that power."""
    arcs = "instanceable = true\n" if instanced else ""
    parts = [f'def Xform "p0"\n{{\n{MESH}}}\n']
    for number in range(1, count):
        below = [f'def "{name}" (\n{arcs}references = </p{number - 1}>\n)\n{{\n}}\n' for name in ("xy" if twice else "x")]
        parts.append(f'def Xform "p{number}"\n{{\n{"".join(below)}}}\n')
    return HEAD + "".join(parts)


def package(name: str, data: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr(name, data)
    return buffer.getvalue()


def nest_prims(levels: int) -> str:
    return HEAD + 'def Xform "a"\n{\n' * levels + MESH + "}\n" * levels


def nested(levels: int, count: int) -> str:
    """Point instancers of so many instances in each other: count to the power of levels."""
    indices, positions = ", ".join(["0"] * count), ", ".join(f"({number}, 0, 0)" for number in range(count))
    parts = [
        f'def PointInstancer "i{level}"\n{{\nrel prototypes = [</set/{f"i{level + 1}" if level < levels - 1 else "ground"}>]\n'
        f"int[] protoIndices = [{indices}]\npoint3f[] positions = [{positions}]\n}}\n"
        for level in range(levels)
    ]
    return within("".join(parts))


def unpacked(text: str) -> bytes:
    """Bytes that were compressed to be written here."""
    return zlib.decompress(base64.b85decode(text))


# Crates with changed tables: USD's own code calls abort(), and asks for 3.7 GB.
ABORTS = unpacked(
    "c-pO0OK;Oa5T0GzjYA+bZ35-lQgLZ{6_pb`;E)CyL0h-6Q4vDIBpYgx*p|ITMdFYn{09ykxFIBd0yj8t;J^_i1QKs(5d{jQgtfa)T*{G=#yj8l"
    "&5n2NomFS159r0w9LNyZm<0dD8hljv=$FMjPB7od9C4gvF7S9W^G@ce2$yD_VZMcV$3M8O%zKz`i_{b%u^6cZd>x4M5XldDh^@_UTVHm4+?VbB"
    "t5(|{9$z1?<!~z=JKi209y<}8uQR&A$R5LQ5am{F@z|4q7z%%JTMvS*N<W7qTo?!wmhO%m7yvj6b53^N^q@v4aXpo|x@A(BwrvWIYu0kJX0_}R"
    "3(BNo%vGt%IPe@&GAkx=VWwicHK11=GGWvRj6(rb+q7uG@~B~zScb~V*wpq@yw$K^mCce5Y|o^oZ3VPLTxv3MoOrWLVI@4M7$tIs@nk+{&#fg!"
    "VF}Os@1AsyQrED&szFH?+@5sH?47fAmFxqJ6*+hQ0pJoW4h~n&orf!iYZ@2Ls!6W`HQY;tss^3)plr`wtde1%_GMzRJZjcR(Wp69wxG~<^KozM"
    "+jsd-UDwkJ%18pj2;qj<*tje&rxsEeeMoiOX`Ls`{>M;4nTbIb;&4HR!vi46uqUDT%%BpF!{LNd4fsv6A77JUcmS@;km?Tb%>dtHczb{!Gc44f"
    "%Fz9Wc|!)|R}$(w<Devz9u$Y+p86P*>TJp_8M=hcOy95E>x7|x=sg5ENGN?wyWa!167@&Hxi|<Te8u^2>Cb%uNf}Mcu)XF5SnSV0L;4{J-=vNu"
    "sRMsWeoo@Wq_B__KP9D)>Gx^;E-k!GZg{ip)y@_1<qqLRiq}d-4)p3bl>F*hRi6Ub@D*d>C&pOZ-jZcs)>K_bV(jIvXHDGuytyK+G&8M?pjD<+"
    "4Nx<_+(f?-`kjhgJ%QavtNoxLz|HQ~ROHXqC0~+6NfgD-)}Dh~O=M>`*8COw5#CGM<f;5bvE6+lZ{RHNsiHPrm^j%^$n!o9d-Fsge|j`Bf1K;D"
    "*XVgIOgX|Y9-U(~tBpmb!ws%m92eDmE~<a$`V_~10JY`eeE"
)
ASKS_FOR_MEMORY = unpacked(
    "c-pO0&u`O66n-<d8;3w>+5`#<v{YQm&sO0?4>+WOM$p!6Y*d7haFYqONNmfVq9Sp~arb}Vz=6wZg~Xr04GtX8isP<?K;k#Fhyn#t!q^=rE^y>Y"
    "pZ(tVy?HZZ&l`1i=8#?*%YzJojZ5%btoir5e<$YD<A}$8S<L+e!)At1OEL)D-^$R<kcx0=h77|thOS?5+Zp;8cEAY94!6q+ktxJTIp9k{oQFt$"
    "$U|&ne#ZuKKl=l@{vT>}?B0o={f!)M`{O4%Z-@I%MCa>_ZZNXP@H0fYbz46EFd&A*zueISXS*`U!%;2_g$XOSMh^`EoPz}?w`h7$CzQCJN?hGC"
    "Da_b51;;h(`FXQeaft;LQZ*K8RAn4^4k?>elejQjwcR?<s}7ko>I5dB2&!#bv}k$Mu*xh$Wo2w?`zhYKTeK=>*$-^bq^4~Jv_o8KGID}=^GsnS"
    "Jg6FFa+dLAF>fzyB*tI`FZy#&Imf7LSYFMbqz7(JxfM3&yj>#)Kx0MDU$_gn49oko)$<qNis72ZoLMvJRiK7@iBQ#`^Bz>}g}EBZ0<|v_i{(+X"
    "PD)1Isj&rxwuis>wZDCj|I~Fot)Pq~AdC=hip|Zd@@i@+h0*I&*FWv^gxUWXPAIc6$Uz(~$}lnnk_>wjiqGs<;&B*BD7Ap!BK!U|8L~t0rwpmy"
    "Aif^Nw^_V1h##<6X#6Kb?{kKx49Kq}G<L;7Nhp0N4%xoOIFlM|$PF2Kgsn_JsNC*`;X&v>0(nR%15CTq2R9Op`@y+545NI-g>dPQd;v)rP0O&o"
    "76e!x%s^B6ED0Z_t`(^ZzfZnP;^m~Uloa14r8ntUY5X!Ryhv_(zT@exHSx(G!s8ULm5Lnb^=~No)pM#o4Y270#=;kjvADA>%f76sx{k!ylimNf"
    "aQ~y$nzYu+v@?QMnN~GGt@vsSeM9J5DsuY-b_cEZgMt9JdfP*hKUSA~NfISd6uaAd4lXv4o!waLYwUA)HEC0)3zMZz_ldlLbG)ZY+DvisR41Xp"
    "`#9{)lf}ZBvB>xdu0PwL7ql?tD8G1g9;-QRJTe^q;=0A-l3K_|^-o-%=J9uN%;n("
)

ROWS = [
    usd("M7 a mesh", GOOD, frames=2),
    usd("A5 CRLF", GOOD.replace("\n", "\r\n")),
    usd("A2 bytes that are no UTF-8", GOOD.replace("int[] faceV", "\u00e9 faceV", 1).encode("latin-1"), "bad-usd", "UTF-8"),
    usd("A2 UTF-16", GOOD.encode("utf-16"), "bad-usd", "cannot be read as USD"),
    usd("A3 zeros at its end", GOOD.encode() + bytes(9), "bad-usd", "cannot be read as USD"),
    usd("A1 nothing", b"", "bad-usd", "cannot be read as USD"),
    usd("A1 a head alone", HEAD, "no-such-prim"),
    usd("A7 200 levels", nest_prims(200), prim="/a"),
    usd("A7 1,000 levels", nest_prims(1000), "bad-usd", "levels deep", "/a"),
    usd("A7 40,000 levels", nest_prims(40_000), "bad-usd", "crashes", "/a"),
    usd(
        "A7 50,000 dictionaries",
        HEAD + 'def Mesh "ground" (\ncustomData = ' + "{dictionary a = " * 50_000 + "{}" + "}" * 50_000 + "\n)\n{\n}\n",
        "bad-usd",
        "crashes",
    ),
    usd("A7 a chain of 300 references", chain(300), "bad-usd", "levels deep", "/p299"),
    usd("M7 a reference to itself", HEAD + refers("ground", "</ground>"), "bad-usd", "is inconsistent"),
    usd(
        "M7 two that refer to each other",
        HEAD + refers("ground", "</b>") + refers("b", "</ground>"),
        "bad-usd",
        "is inconsistent",
    ),
    usd("M7 a reference within the file", HEAD + refers("ground", "</b>") + 'def Xform "b"\n{\n' + MESH + "}\n"),
    usd("M7 a file outside", HEAD + refers("ground", "@../../etc/passwd.usda@"), "bad-path", "outside"),
    usd("M7 an address", HEAD + refers("ground", "@http://example.com/a.usda@"), "bad-path", "address"),
    usd("M7 an expression", HEAD + refers("ground", '@`"${A}.usda"`@'), "bad-path", "expression"),
    usd("M4 counts of 2^31", GOOD.replace("[3, 3]", "[2147483647, 3]"), "bad-mesh", "number of corners"),
    usd("M4 counts below 0", GOOD.replace("[3, 3]", "[-3, 9]"), "bad-mesh"),
    usd("M4 indices below 0", GOOD.replace("[0, 1, 2,", "[0, -1, 2,"), "bad-mesh", "missing point"),
    usd("M4 indices beyond", GOOD.replace("[0, 1, 2,", "[0, 99, 2,"), "bad-mesh", "missing point"),
    usd("M5 nan", GOOD.replace("(-100, 0, -100)", "(nan, 0, 0)"), "bad-mesh", "not a finite point"),
    usd("M5 1e999", GOOD.replace("(-100, 0, -100)", "(1e999, 0, 0)"), "bad-mesh", "not a finite point"),
    usd("M5 no points", GOOD.replace("[(-100, 0, -100), (-100, 0, 100), (100, 0, 100), (100, 0, -100)]", "[]"), "bad-mesh"),
    usd("M10 metres a unit: nan", GOOD.replace("0.001", "nan"), "bad-usd", "metersPerUnit"),
    usd("M10 metres a unit: 0", GOOD.replace("0.001", "0"), "bad-usd", "metersPerUnit"),
    usd("M10 metres a unit: -1", GOOD.replace("0.001", "-1"), "bad-usd", "metersPerUnit"),
    usd("N7 time codes a second: 0", GOOD.replace("Second = 24", "Second = 0"), "bad-usd", "timeCodesPerSecond"),
    usd("N7 time codes a second: nan", GOOD.replace("Second = 24", "Second = nan"), "bad-usd", "timeCodesPerSecond"),
    usd("Y18 a matrix of zeros", within(placed("0, 0, 0, 0")), "bad-mesh", "no face with an area", "/set"),
    usd("Y18 a matrix of nan", within(placed("nan, 0, 0, 0")), "bad-mesh", "not a finite point", "/set"),
    usd(
        "Y18 an order of what is not there",
        within('uniform token[] xformOpOrder = ["xformOp:nothing", "garbage"]'),
        "bad-usd",
        "",
        "/set",
    ),
    usd("M8 a package", package("set.usda", GOOD.encode()), file="set.usdz"),
    usd("M8 a package of levels", package("set.usda", nest_prims(40_000).encode()), "bad-usd", "crashes", "/a", "set.usdz"),
    usd("M8 a package with a name that leaves", package("../../set.usda", GOOD.encode()), "bad-usd", "leaves", file="set.usdz"),
    usd("M3 a crate that aborts", ABORTS, "bad-usd", "crashes", file="set.usdc"),
    usd("M3 a crate that aborts in a package", package("set.usdc", ABORTS), "bad-usd", "crashes", file="set.usdz"),
    usd("M3 a crate that asks for 3.7 GB", ASKS_FOR_MEMORY, "bad-usd", "cannot be read", file="set.usdc"),
    usd("A23 10^6 instances", nested(3, 100), "too-large", "1,010,100 instances", "/set"),
    usd("A23 10^8 instances", nested(8, 10), "too-large", "instances", "/set"),
    usd("M11 a picture", b"\x89PNG\r\n\x1a\n" + bytes(90), "bad-usd", "cannot be read as USD", file="set.usd"),
    usd(
        "M3 a crate whose table lies",
        b"PXR-USDC" + bytes([0, 8, 0, 0, 0, 0, 0, 0]) + struct.pack("<q", 2**62) + bytes(64),
        "bad-usd",
        "cannot be read as USD",
        file="set.usdc",
    ),
    usd("M3 a crate of nothing else", b"PXR-USDC" + b"\xff" * 80, "bad-usd", "cannot be read as USD", file="set.usdc"),
]
SLOW = [
    usd(
        "A7 100,000 parentheses",
        HEAD + 'def Mesh "ground"\n{\npoint3f[] points = ' + "(" * 100_000 + ")" * 100_000 + "\n}\n",
        "bad-usd",
    ),
    usd("A23 2^23 prims", chain(24, twice=True), "bad-usd", "", "/p23"),
    usd("A23 2^40 instances", chain(41, twice=True, instanced=True), "bad-usd", "", "/p40"),
    usd("A7 a chain of 20,000 references", chain(20_000), "bad-usd", "", "/p19999"),
]

"""PMX and PMD files written byte by byte, in MMD's own frame (left-handed, facing -Z) and unit."""

import struct
from dataclasses import dataclass, field

NONE = (0.0, 0.0, 0.0)


@dataclass
class Bone:
    """A bone as PMX says it; `ik` is (target, loops, limit, [(bone, (lower, upper) or None)])."""

    name: str
    position: tuple = NONE
    parent: int = -1
    layer: int = 0
    tail: object = NONE
    append: tuple | None = None  # (bone, ratio, flags 0x100 rotation, 0x200 translation, 0x80 local)
    fixed: tuple | None = None
    local: tuple | None = None
    ik: tuple | None = None
    after_physics: bool = False
    external: bool = False


@dataclass
class Body:
    name: str
    bone: int = -1
    group: int = 0
    mask: int = 0xFFFF
    shape: int = 0
    size: tuple = (1.0, 1.0, 1.0)
    position: tuple = NONE
    rotation: tuple = NONE
    mass: float = 1.0
    damping: tuple = (0.5, 0.6)
    restitution: float = 0.1
    friction: float = 0.7
    mode: int = 1


@dataclass
class Joint:
    name: str
    bodies: tuple = (0, 1)
    position: tuple = NONE
    rotation: tuple = NONE
    limits: tuple = (NONE, NONE, NONE, NONE)  # lower, upper, lower and upper of angles
    springs: tuple = (NONE, NONE)


@dataclass
class Model:
    """`vertices` are (position, normal, uv, deform) with deform (kind, bones, numbers)."""

    name: str = "人形"
    vertices: list = field(default_factory=list)
    triangles: list = field(default_factory=list)
    textures: list = field(default_factory=list)
    materials: list = field(default_factory=list)  # (name, diffuse, ambient, flags, texture, corners)
    bones: list = field(default_factory=list)
    morphs: list = field(default_factory=list)  # (name, kind, offsets as bytes of each)
    bodies: list = field(default_factory=list)
    joints: list = field(default_factory=list)


def plank(**changes):
    """A board of four vertices with every kind of weights PMX 2.0 has, two materials, a chain of bones, two bodies and
    a joint.
    """
    up = (0.0, 0.0, -1.0)
    model = Model(
        vertices=[
            ((-1.0, 0.0, 0.0), up, (0.0, 1.0), (0, [0], [])),
            ((1.0, 0.0, 0.0), up, (1.0, 1.0), (1, [0, 1], [0.75])),
            ((1.0, 20.0, 1.0), up, (1.0, 0.0), (2, [1, 2, -1, 0], [2.0, 2.0, 0.0, 0.0])),
            ((-1.0, 20.0, 1.0), up, (0.0, 0.0), (3, [1, 2], [0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0])),
        ],
        triangles=[0, 2, 1, 0, 3, 2],  # clockwise as seen from -Z
        textures=["tex\\skin.png"],
        materials=[("肌", (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 1, 0, 3), ("服", (0.5, 0.5, 0.5, 0.5), (0.2, 0.2, 0.2),
        0, -1, 3)],
        bones=[
            Bone("センター", (0.0, 8.0, 0.5), tail=(0.0, 1.0, 0.0)),
            Bone("上半身", (0.0, 12.0, 0.0), 0, tail=2),
            Bone("スカート", (0.0, 16.0, -2.0), 1, 1, append=(1, 0.5, 0x100), fixed=(0.0, 0.0, 1.0),
                local=((1.0, 0.0, 0.0),
            (0.0, 0.0, 1.0))),
        ],
        morphs=[("あ", 1, [struct.pack("<3f", 0, 1, 0)]), ("材", 8, [bytes(1 + 112)])],
        bodies=[
            Body("芯", 1, mode=0, shape=1, position=(0.0, 12.0, 1.0), rotation=(0.1, 0.2, 0.3)),
            Body("布", 2, 3, 0xFFF7, 2, (0.5, 2.0, 0.0), (0.0, 16.0, -2.0)),
        ],
        joints=[
            Joint("糸", (0, 1), (0.0, 14.0, 1.0), (0.4, 0.0, 0.0),
                  ((-1.0, -2.0, -3.0), (4.0, 5.0, 6.0), (-0.1, -0.2, -0.3), (0.4, 0.5, 0.6)), ((1.0, 2.0, 3.0), (4.0,
                  5.0, 6.0))),
        ],
    )  # fmt: skip
    for name, value in changes.items():
        setattr(model, name, value)
    return model


def pmx(model, version=2.0, utf8=False, sizes=(1, 1, 1, 2, 1, 1), uvs=0, tail=True):
    """The bytes of a PMX; `sizes` are those of indices of vertices, textures, materials, bones, morphs and bodies."""
    encoding = "utf-8" if utf8 else "utf-16-le"
    vertex, texture, material, bone, morph, body = sizes

    def text(value):
        raw = value.encode(encoding)
        return struct.pack("<i", len(raw)) + raw

    def index(value, size, signed=True):
        return int(value).to_bytes(size, "little", signed=signed or size == 4)

    out = (
        b"PMX "
        + struct.pack("<fB8B", version, 8, int(utf8), uvs, *sizes)
        + text(model.name)
        + text("doll")
        + text("注")
        + text("")
    )
    out += struct.pack("<i", len(model.vertices))
    for position, normal, uv, (kind, bones, numbers) in model.vertices:
        out += struct.pack("<8f", *position, *normal, *uv) + bytes(16 * uvs) + bytes([kind])
        out += (
            b"".join(index(some, bone) for some in bones)
            + struct.pack(f"<{len(numbers)}f", *numbers)
            + struct.pack("<f", 1)
        )
    out += struct.pack("<i", len(model.triangles)) + b"".join(
        index(some, vertex, signed=False) for some in model.triangles
    )
    out += struct.pack("<i", len(model.textures)) + b"".join(text(some) for some in model.textures)
    out += struct.pack("<i", len(model.materials))
    for name, diffuse, ambient, flags, picture, corners in model.materials:
        out += text(name) + text("") + struct.pack("<4f3ff3fB", *diffuse, 0, 0, 0, 5, *ambient, flags) + bytes(20)
        out += (
            index(picture, texture)
            + index(-1, texture)
            + b"\0\0"
            + index(-1, texture)
            + text("")
            + struct.pack("<i", corners)
        )
    out += struct.pack("<i", len(model.bones)) + b"".join(_bone(some, text, index, bone) for some in model.bones)
    out += struct.pack("<i", len(model.morphs))
    sizes_of = {0: morph, 1: vertex, 2: bone, 3: vertex, 8: material, 10: body}
    for name, kind, offsets in model.morphs:
        out += text(name) + text("") + struct.pack("<BBi", 1, kind, len(offsets))
        out += b"".join(bytes(sizes_of[kind]) + rest for rest in offsets)
    out += (
        struct.pack("<i", 1)
        + text("表情")
        + text("Exp")
        + struct.pack("<Bi", 1, 2)
        + b"\0"
        + index(0, bone)
        + b"\1"
        + index(0, morph)
    )
    if not tail:
        return out
    out += struct.pack("<i", len(model.bodies))
    for some in model.bodies:
        out += text(some.name) + text("") + index(some.bone, bone) + _body(some)
    out += struct.pack("<i", len(model.joints))
    for some in model.joints:
        out += text(some.name) + text("") + b"\0" + b"".join(index(one, body) for one in some.bodies) + _joint(some)
    return out


def _bone(some, text, index, size):
    flags = (
        0x2
        | 0x4
        | 0x8
        | 0x10
        | (isinstance(some.tail, int) and 1)
        | (some.ik is not None and 0x20)
        | (some.append[2] if some.append else 0)
    )
    flags |= (
        (some.fixed is not None and 0x400)
        | (some.local is not None and 0x800)
        | (some.after_physics and 0x1000)
        | (some.external and 0x2000)
    )
    out = (
        text(some.name)
        + text("")
        + struct.pack("<3f", *some.position)
        + index(some.parent, size)
        + struct.pack("<iH", some.layer, flags)
    )
    out += index(some.tail, size) if isinstance(some.tail, int) else struct.pack("<3f", *some.tail)
    if some.append:
        out += index(some.append[0], size) + struct.pack("<f", some.append[1])
    if some.fixed is not None:
        out += struct.pack("<3f", *some.fixed)
    if some.local is not None:
        out += struct.pack("<6f", *some.local[0], *some.local[1])
    if some.external:
        out += struct.pack("<i", 7)
    if some.ik is not None:
        target, loops, limit, links = some.ik
        out += index(target, size) + struct.pack("<ifi", loops, limit, len(links))
        for link, limits in links:
            out += (
                index(link, size)
                + bytes([limits is not None])
                + (struct.pack("<6f", *limits[0], *limits[1]) if limits else b"")
            )
    return out


def _body(some):
    numbers = (*some.size, *some.position, *some.rotation, some.mass, *some.damping, some.restitution, some.friction)
    return struct.pack("<BHB14fB", some.group, some.mask, some.shape, *numbers, some.mode)


def _joint(some):
    numbers = [value for three in (some.position, some.rotation, *some.limits, *some.springs) for value in three]
    return struct.pack("<24f", *numbers)


def pmd(model, ik=(), english=True, tail=True, kinds=None):
    """The bytes of a PMD; `ik` are (bone, target, loops, limit, [links]), `kinds` are (kind, tail, other) of bones."""

    def field_of(value, size):
        return value.encode("cp932")[:size].ljust(size, b"\0")

    out = (
        b"Pmd"
        + struct.pack("<f", 1.0)
        + field_of(model.name, 20)
        + field_of("注", 256)
        + struct.pack("<I", len(model.vertices))
    )
    for position, normal, uv, (_, bones, numbers) in model.vertices:
        pair, share = (bones * 2)[:2], numbers[0] if numbers else 1.0
        out += struct.pack(
            "<8f2HBB", *position, *normal, *uv, *(some & 0xFFFF for some in pair), round(100 * min(share, 1)), 0
        )
    out += struct.pack("<I", len(model.triangles)) + struct.pack(f"<{len(model.triangles)}H", *model.triangles)
    out += struct.pack("<I", len(model.materials))
    for _, diffuse, ambient, _, picture, corners in model.materials:
        name = model.textures[picture] + "*gloss.sph" if picture >= 0 else ""
        out += (
            struct.pack("<4ff3f3f", *diffuse, 5, 0, 0, 0, *ambient)
            + b"\0\0"
            + struct.pack("<I", corners)
            + field_of(name, 20)
        )
    out += struct.pack("<H", len(model.bones))
    for number, some in enumerate(model.bones):
        kind, end, other = (kinds or {}).get(number, (1, 0, 0))
        out += field_of(some.name, 20) + struct.pack(
            "<HHBH3f", some.parent & 0xFFFF, end, kind, other & 0xFFFF, *some.position
        )
    out += struct.pack("<H", len(ik))
    for goal, target, loops, limit, links in ik:
        out += struct.pack("<HHBHf", goal, target, len(links), loops, limit) + struct.pack(f"<{len(links)}H", *links)
    out += struct.pack("<H", len(model.morphs))
    for name, _, offsets in model.morphs:
        out += field_of(name, 20) + struct.pack("<IB", len(offsets), 1) + bytes(16 * len(offsets))
    out += b"\1\0\0" + b"\1" + field_of("体", 50) + struct.pack("<IHB", 1, 0, 1)
    if not tail:
        return out
    out += bytes([english])
    if english:
        out += field_of("doll", 20) + bytes(256) + b"".join(field_of("bone", 20) for _ in model.bones)
        out += bytes(20 * max(len(model.morphs) - 1, 0) + 50)
    out += bytes(1000) + struct.pack("<I", len(model.bodies))
    for some in model.bodies:
        out += field_of(some.name, 20) + struct.pack("<H", some.bone & 0xFFFF) + _body(some)
    out += struct.pack("<I", len(model.joints))
    for some in model.joints:
        out += field_of(some.name, 20) + struct.pack("<II", *some.bodies) + _joint(some)
    return out

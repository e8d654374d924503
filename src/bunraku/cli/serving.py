"""`bunraku serve`: tools in one folder that other programs call by the Model Context Protocol."""

from __future__ import annotations

import asyncio
import functools
import inspect
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, make_dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_type_hints

import tyro

from bunraku.core.files import path_inside
from bunraku.core.request import from_json
from bunraku.errors import BunrakuError, FormatError, MissingExtraError, NotUnderstood, OptionError, sentence_of
from bunraku.pipelines.requests import Apparel, Constraints, Request, Sampling, TransferRequest

if TYPE_CHECKING:
    from bunraku.core.animation import AnimatedCharacter

PICTURE_FRAMES = 6
"""Moments that the picture of an animation shows."""
APPAREL = ("none", "rigid", "simulate", "learn", "auto")
"""Ways in which apparel moves that name no file."""
ALONE = ("path", "pin", "loop", "in_place")
"""Constraints that name no other clip."""
MOST_FOUND = 50
"""Clips that a search gives."""
MOST_FILES = 1000
"""Files that are listed."""


@dataclass(frozen=True)
class Answer:
    """What a tool gives: what was done, as plain values, and a PNG of it, b"" for none."""

    facts: dict[str, Any]
    picture: bytes = b""


@dataclass(frozen=True)
class Tools:
    """Tools over one folder; their docstrings are what clients read.

    Args:
        folder: Where files are read and written; no file outside it is.
    """

    folder: Path

    @cached_property
    def _root(self) -> Path:
        root = self.folder.expanduser().resolve()
        if not root.is_dir():
            raise FormatError(self.folder, "this is not a folder; name one that exists")
        return root

    def path(self, name: str) -> Path:
        """The file of a name; FormatError where it lies outside the folder."""
        path = path_inside(self._root, name) if name.strip() else None
        if path is None:
            raise FormatError(name or "a file without a name", "name a file in the folder that is served, or below it")
        return path

    def files(self) -> Answer:
        """The files of the served folder, at most 1,000."""
        names: list[str] = []
        for here, folders, files in os.walk(self._root):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            shown = [name for name in sorted(files) if not name.startswith(".")]
            names += [str(Path(here, name).relative_to(self._root)) for name in shown]
            if len(names) >= MOST_FILES:
                break
        return Answer({"files": names[:MOST_FILES]})

    def animate(
        self, character: str, sentence: str, output: str = "", fps: float = 30.0,
        sampling: Sampling = Sampling(), constraints: list[dict[str, Any]] = [],  # noqa: B006, B008  only read, frozen
        apparel: Apparel = Apparel(),  # noqa: B008  frozen
        rig: Literal["auto", "own", "handles"] = "auto", force: bool = False,
    ) -> Answer:  # fmt: skip
        """Make a character do what a sentence says and write it (.glb, .fbx, .usdc, .bvh, .vrma, ...); gives a picture
        of six moments.

        Args:
            character: Its file in the folder: any mesh, with or without a rig.
            sentence: What it does: "walks forward, then waves"; or several in a row with their seconds, "walks:4;
                jumps:2".
            output: The file to write; named by itself where empty.
            fps: Frames a second.
            sampling: Seconds, seed and how the motion is drawn.
            constraints: What it must meet, such as {"kind": "loop"}, {"kind": "in_place"}.
            apparel: How hair and clothes move.
            rig: What moves: the bones of its own rig, 30 handles, or what fits.
            force: Go on where no movement of the sentence is understood.
        """
        from bunraku.files import load_character
        from bunraku.pipelines.animator import Animator

        limits = Constraints.from_json(constraints)
        _check_files(apparel, limits)
        request = Request(sentence, sampling, limits, apparel, force=force, rig=rig)
        request.check()
        request = request.with_parsed()
        target = self._target(output, character, request.prompt)
        notes: list[str] = []
        animation = Animator.shipped(note=notes.append)(load_character(self.path(character)), request)
        return self._written(animation, target, fps, list(dict.fromkeys(notes)))

    def transfer(
        self, character: str, motion: str, output: str = "", fps: float = 30.0,
        onto: Literal["auto", "handles", "rig"] = "auto", apparel: Apparel = Apparel(),  # noqa: B008  frozen
        clip: str = "0", names: dict[str, str] = {},  # noqa: B006  only read
    ) -> Answer:  # fmt: skip
        """Put a motion on a character and write it; gives a picture of six moments.

        Args:
            character: Its file in the folder.
            motion: A file in the folder (.bvh, .fbx, .glb, .vrma, .vmd, AMASS .npz), or "clip:NAME" of the library.
            output: The file to write; named by itself where empty.
            fps: Frames a second.
            onto: What moves: the bones of its own rig, 30 handles, or what fits.
            apparel: How hair and clothes move.
            clip: Number or name of the clip of a motion file with several.
            names: Joints of the motion's skeleton by SMPL's names, such as {"left_hip": "LeftUpLeg"}.
        """
        from bunraku.files import load_character
        from bunraku.generation.library import clip as find_clip
        from bunraku.pipelines.animator import Animator
        from bunraku.pipelines.transfer import Source, transferred

        _check_files(apparel)
        request = TransferRequest(onto, apparel, None, "predict", fps, names or None, clip)
        request.check()
        kind, _, name = motion.partition(":")
        target = self._target(output, character, name if kind == "clip" else Path(motion).stem)
        given = find_clip(name).motion() if kind == "clip" else self.path(motion)
        source = Source(given, request.fps, request.names, request.clip)
        animation = transferred(Animator.shipped(), load_character(self.path(character)), source, request)
        return self._written(animation, target, fps, [])

    def rig(self, character: str, output: str = "", skeleton: Literal["", "mixamo", "vrm", "unreal"] = "") -> Answer:
        """Give a character its 30 handles as a skin, or the skeleton of an engine; gives a picture of both sides.

        Args:
            character: Its file in the folder.
            output: The file to write; named by itself where empty.
            skeleton: Whose joints a person gets in place of handles.
        """
        from bunraku.files import load_character, save_character
        from bunraku.pipelines.animate import rig, with_skeleton
        from bunraku.render.preview import save_still

        target = self._target(output, character, "rigged")
        mesh = load_character(self.path(character))
        handles = rig(mesh)
        if skeleton:
            mesh = with_skeleton(mesh, skeleton, handles=handles)
            save_character(mesh, target, rig=True)
        else:
            save_character(mesh, target, handles)
        picture = _png(lambda path: save_still(mesh, path, None if skeleton else handles, views=2))
        return Answer({"file": self._name(target), "height_m": round(mesh.height, 4)}, picture)

    def inspect(self, file: str) -> Answer:
        """Tell what a character's file holds: size, height, bones, clips; gives a picture of both sides.

        Args:
            file: A file in the folder.
        """
        from bunraku.files import Source, clip_names, load_with_clips
        from bunraku.render.preview import save_still

        mesh = load_with_clips(self.path(file), 30.0)
        source = mesh.source
        facts = {
            "name": mesh.name, "vertices": len(mesh.vertices), "triangles": len(mesh.faces),
            "height_m": round(mesh.height, 4), "bones": list(mesh.rig.names) if mesh.rig is not None else [],
            "clips": clip_names(source.document) if isinstance(source, Source) else [],
        }  # fmt: skip
        return Answer(facts, _png(lambda path: save_still(mesh, path, views=2)))

    def render(self, file: str, output: str = "", clip: str = "", fps: float = 30.0) -> Answer:
        """Show a clip of a file as a picture of six moments, and write a video where one is named.

        Args:
            file: A GLB or FBX with a clip.
            output: A video (.mp4, .webp, .gif) or contact sheet (.png) to write; none where empty.
            clip: Number or name of the clip; the first where empty.
            fps: Frames a second.
        """
        from bunraku.files import load_animation
        from bunraku.render.preview import save_preview

        animation = load_animation(self.path(file), clip or 0, fps)
        facts: dict[str, Any] = {"seconds": round(len(animation.motion) / fps, 3)}
        if output:
            facts["file"] = self._name(save_preview(animation, self._output(output), fps=fps))
        return Answer(facts, _png(lambda path: save_preview(animation, path, frames=PICTURE_FRAMES)))

    def clips(self, text: str = "") -> Answer:
        """Search the library of captured and made clips; `transfer` puts one on a character as "clip:NAME".

        Args:
            text: Words, such as "zombie walk"; all where empty.
        """
        from bunraku.generation.library import search

        clips = [{"name": clip.name, "sentence": clip.sentence, "tags": list(clip.tags)} for clip in search(text)]
        return Answer({"clips": clips[:MOST_FOUND]})

    def _target(self, output: str, character: str, said: str) -> Path:
        from bunraku.pipelines.requests import clip_names

        return self._output(output or f"{Path(character).stem}-{next(iter(clip_names([said])))}.glb")

    def _output(self, name: str) -> Path:
        """A file to write; OptionError where a file of this name exists."""
        target = self.path(name)
        if target.exists():
            raise OptionError(f"{self._name(target)} is there already; name another file with `output`")
        return target

    def _name(self, path: Path) -> str:
        return str(path.resolve().relative_to(self._root))

    def _written(self, made: AnimatedCharacter, target: Path, fps: float, notes: list[str]) -> Answer:
        from bunraku.core.animation import Animation, PointAnimation
        from bunraku.render.preview import save_preview

        rate = {} if target.suffix.lower() in (".npz", ".vmd") else {"fps": fps}
        written = made.save(target, **rate)
        shown = made if isinstance(made, PointAnimation) else Animation(made.character, made.handles, made.motion)
        facts = {"file": self._name(written), "seconds": round(len(made.motion) / made.fps, 3), "notes": notes}
        return Answer(facts, _png(lambda path: save_preview(shown, path, frames=PICTURE_FRAMES)))


def _check_files(apparel: Apparel, constraints: Constraints | None = None) -> None:
    """Raise OptionError where a request names files, which may lie anywhere."""
    if apparel.motion not in APPAREL:
        raise OptionError(f"apparel is one of {', '.join(APPAREL)} here, not '{apparel.motion}'")
    if constraints is not None and any(constraint.kind not in ALONE for constraint in constraints):
        raise OptionError(f"constraints are of the kinds {', '.join(ALONE)} here")


def _png(draw: Callable[[Path], object]) -> bytes:
    """The picture that is drawn to a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.png")
        draw(path)
        return path.read_bytes()


def _form(work: Callable[..., Answer]) -> type:
    """A dataclass with the arguments of a tool."""
    hints = get_type_hints(work)
    given = inspect.signature(work).parameters.values()
    needed = [(one.name, hints[one.name]) for one in given if one.default is one.empty]
    others = [(one.name, hints[one.name], field(default=None)) for one in given if one.default is not one.empty]
    return make_dataclass(work.__name__, [*needed, *others])


TOOLS = ("files", "animate", "transfer", "rig", "inspect", "render", "clips")
"""Methods of `Tools` that are called from outside."""
DEBUG = "start the server with BUNRAKU_DEBUG=1"
INSTRUCTIONS = (
    "Bunraku animates any 3D character: a mesh and a sentence give an animation. Files are named as in the served "
    "folder; `files` lists them. Sentences are about one body's movement, such as: walks forward, then waves with the "
    "left hand. What is not understood is answered with the nearest thing that is. A file that is there is never "
    "replaced."
)


def mcp_server(folder: Path) -> Any:
    """The server of the tools over a folder; MissingExtraError where the SDK is not installed."""
    try:
        from mcp.server.mcpserver import Image, MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
    except ImportError as error:
        raise MissingExtraError("mcp", "serve", "`bunraku serve`") from error
    from bunraku import __version__

    tools = Tools(folder)
    works = {work.__name__: work for work in (getattr(tools, name) for name in TOOLS)}
    forms = {name: _form(work) for name, work in works.items()}

    class Server(MCPServer):
        """Reads the arguments of tools as strictly as all other requests are read."""

        async def call_tool(self, name: str, arguments: dict[str, Any], context: Any = None) -> Any:
            if name not in forms:
                raise ToolError(f"there is no tool '{name[:40]}'; there are {', '.join(forms)}")
            try:
                from_json(forms[name], arguments, f"the tool {name}")
            except BunrakuError as error:
                raise ToolError(str(error)) from None
            return await super().call_tool(name, arguments, context)

    server = Server("bunraku", instructions=INSTRUCTIONS, version=__version__)
    in_order = asyncio.Lock()  # networks and renderer are made for one call at a time

    def as_tool(work: Callable[..., Answer]) -> Callable[..., Any]:
        """A tool that gives facts and a picture, and its errors as sentences."""

        @functools.wraps(work)
        async def tool(**arguments: object) -> Any:
            try:
                async with in_order:
                    answer = await asyncio.to_thread(work, **arguments)
            except Exception as error:
                more = ", or set `force`" if isinstance(error, NotUnderstood) else ""
                raise ToolError(f"{sentence_of(error, debug=DEBUG)}{more}") from error
            return [answer.facts, *([Image(data=answer.picture, format="png")] if answer.picture else [])]

        return tool

    for work in works.values():
        server.tool(structured_output=False)(as_tool(work))
    return server


@dataclass(frozen=True)
class Serve:
    """Let other programs call Bunraku by the Model Context Protocol, over standard input and output: animate, transfer,
    rig, inspect, render and clips, each with a picture of what it made.

    All files lie in FOLDER or below it; nothing else is read or written, and nothing is replaced. A program of yours
    starts it with: bunraku serve FOLDER

    Example: bunraku serve ~/characters
    """

    folder: tyro.conf.Positional[Path] = Path()
    """Where files are read and written."""

    def run(self) -> None:
        if not self.folder.is_dir():
            raise FormatError(self.folder, "this is not a folder; name one that exists")

        mcp_server(self.folder).run("stdio")

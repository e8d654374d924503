"""The tools as a server of the Model Context Protocol (MCP), by its official SDK."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from bunraku.core.request.json_form import from_json
from bunraku.errors import BunrakuError, MissingExtraError
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku.pipelines.requests.transfer import TransferRequest
from bunraku.serving.tools import Answer, Tools

__all__ = ["mcp_server"]

INSTRUCTIONS = (
    "Bunraku animates any 3D character: a mesh and a sentence give an animation. Files are named as in the served "
    "folder; `files` lists them. Sentences are about one body's movement, such as: walks forward, then waves with the "
    "left hand. What is not understood is answered with the nearest thing that is. A file that is there is never "
    "replaced."
)


def mcp_server(folder: Path) -> Any:
    """The server.

    Args:
        folder: Where files are read and written.

    Raises:
        MissingExtraError: The SDK is not installed.
    """
    try:
        from mcp.server.mcpserver import Image, MCPServer
        from mcp.server.mcpserver.exceptions import ToolError
    except ImportError as error:
        raise MissingExtraError("mcp", "serve", "`bunraku serve`") from error
    from bunraku import __version__

    server, tools = MCPServer("bunraku", instructions=INSTRUCTIONS, version=__version__), Tools(folder)
    turn = asyncio.Lock()  # networks and renderer are made for one call at a time

    async def answered(work: Callable[[], Answer]) -> Any:
        """What a tool gives, as facts and a picture; its errors as sentences."""
        try:
            async with turn:
                found = await asyncio.to_thread(work)
        except BunrakuError as error:
            raise ToolError(str(error)) from None
        return [found.facts, *([Image(data=found.picture, format="png")] if found.picture else [])]

    @server.tool(structured_output=False)
    async def files() -> Any:
        """The files of the served folder."""
        return await answered(tools.files)

    @server.tool(structured_output=False)
    async def animate(
        character: str,
        sentence: str,
        output: str = "",
        fps: float = 30.0,
        sampling: Sampling = Sampling(),  # noqa: B008  frozen
        constraints: list[dict[str, Any]] = [],  # noqa: B006  only read
        apparel: Apparel = Apparel(),  # noqa: B008  frozen
        rig: Literal["auto", "own", "handles"] = "auto",
        force: bool = False,
    ) -> Any:
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

        def work() -> Answer:
            found = Constraints.from_json(constraints)
            return tools.animate(
                character, Request(sentence, sampling, found, apparel, force=force, rig=rig), output, fps
            )

        return await answered(work)

    @server.tool(structured_output=False)
    async def transfer(
        character: str,
        motion: str,
        output: str = "",
        fps: float = 30.0,
        request: dict[str, Any] = {},  # noqa: B006
    ) -> Any:
        """Put a motion on a character and write it; gives a picture of six moments.

        Args:
            character: Its file in the folder.
            motion: A file in the folder (.bvh, .fbx, .glb, .vrma, .vmd, AMASS .npz), or "clip:NAME" of the library.
            output: The file to write; named by itself where empty.
            fps: Frames a second.
            request: How: `onto` ("auto", "handles", "rig"), `apparel`, `clip`, `names`.
        """

        def work() -> Answer:
            return tools.transfer(character, motion, from_json(TransferRequest, request, "request"), output, fps)

        return await answered(work)

    @server.tool(structured_output=False)
    async def rig(character: str, output: str = "", skeleton: Literal["", "mixamo", "vrm", "unreal"] = "") -> Any:
        """Give a character its 30 handles as a skin, or the skeleton of an engine; gives a picture of both sides.

        Args:
            character: Its file in the folder.
            output: The file to write; named by itself where empty.
            skeleton: Whose joints a person gets in place of handles.
        """
        return await answered(functools.partial(tools.rig, character, output, skeleton))

    @server.tool(structured_output=False)
    async def inspect(file: str) -> Any:
        """Tell what a character's file holds: size, height, bones, clips; gives a picture of both sides.

        Args:
            file: A file in the folder.
        """
        return await answered(functools.partial(tools.inspect, file))

    @server.tool(structured_output=False)
    async def render(file: str, output: str = "", clip: str = "", fps: float = 30.0) -> Any:
        """Show a clip of a file as a picture of six moments, and write a video where one is named.

        Args:
            file: A GLB or FBX with a clip.
            output: A video (.mp4, .webp, .gif) or contact sheet (.png) to write; none where empty.
            clip: Number or name of the clip.
            fps: Frames a second.
        """
        return await answered(functools.partial(tools.render, file, output, clip, fps))

    @server.tool(structured_output=False)
    async def clips(text: str = "") -> Any:
        """Search the library of captured and made clips; `transfer` puts one on a character as "clip:NAME".

        Args:
            text: Words, such as "zombie walk"; all where empty.
        """
        return await answered(functools.partial(tools.clips, text))

    return server

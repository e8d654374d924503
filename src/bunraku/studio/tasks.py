"""What the worker does: open a character, make takes, change them, carry a motion over, write files.

A task reads and writes the binary files of the store's folders; records are the server's. It gets what it needs as
plain values and gives plain values back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import HandleMotion
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.retarget.fit import Stages
from bunraku.retarget.stages.pins import Pin
from bunraku.studio.clips import Dressed, Take, body_of, save_handles
from bunraku.studio.dressing import Apparel, dressed_anew
from bunraku.studio.opened import Settings, opened_character, told
from bunraku.studio.workspace import Workspace

__all__ = ["TASKS", "run_task"]

Report = Callable[[str, float], None]
Partly = Callable[[dict[str, Any]], None]
Params = dict[str, Any]
FPS = 20.0
"""What the network knows; takes of other rates, carried over from files, are resampled before they are changed."""
BODIES = (".bvh", ".vrma", ".vmd", ".npz")
"""Formats of the motion of a body, in which apparel has no place."""
DRAFT_STEPS = 3
DRAFT_STAGES = Stages(smooth=False, feet=False, floor=False)
"""Of a draft, which is there to be seen at once."""


def _open(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    from bunraku.io import save_character
    from bunraku.pipelines.animate import rig

    place = shop.place("characters", params["character"])
    settings = Settings(**params["settings"])
    source = place / params["file"]
    report("read", 0.1)
    character, taken = opened_character(source, settings)
    report("handles", 0.3)
    handles = rig(character, handles=settings.handles)
    report("write", 0.8)
    save_character(character, place / "mesh.glb", handles)
    (place / "bones.glb").unlink(missing_ok=True)
    save_handles(handles, place / "handles.npz")
    return {**taken, **told(character, handles), "clips": _clips_of(character)}


def _clips_of(character: Character) -> list[str]:
    """Names of the clips that the character's file brings."""
    from bunraku.formats.gltf.read import Source
    from bunraku.io.play import clip_names

    source = character.source
    return clip_names(source.document)[:50] if isinstance(source, Source) and character.rig is not None else []


def _directed(params: Params) -> tuple[GroundPath | None, list[Pin]]:
    path, pins = params.get("path"), params.get("pins") or []
    return (
        GroundPath(tuple((float(x), float(z)) for x, z in path)) if path else None,
        [
            Pin(
                str(pin["part"]),
                float(pin["time"]),
                tuple(float(value) for value in pin["position"]),  # type: ignore[arg-type]
                None if pin.get("rotation") is None else np.asarray(pin["rotation"], float),
                float(pin.get("hold", 0)),
            )
            for pin in pins
        ],
    )


def _stages(without: Sequence[str]) -> Stages | None:
    from bunraku.pipelines.apply import GENERATED_STAGES

    known = set(Stages.__dataclass_fields__)
    for stage in without:
        if stage not in known:
            raise OptionError(f"there is no stage '{stage}'; there are {', '.join(sorted(known))}")
    return replace(GENERATED_STAGES, **dict.fromkeys(without, False)) if without else None


def _animate(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """Takes of one script: drafts first, all of them in one pass, then each in full."""
    from bunraku.pipelines.animate import generate
    from bunraku.pipelines.apply import apply_motion, apply_rigged, apply_simulated, reference_of, reference_path
    from bunraku.pipelines.together import check_together

    owner, takes, seeds = params["character"], params["takes"], [int(seed) for seed in params["seeds"]]
    character, handles = shop.character(owner)
    anatomy = Anatomy.of(character, handles)
    path, pins = _directed(params)
    apparel, loop, in_place = Apparel.of(params), bool(params["loop"]), bool(params["in_place"])
    before = body_of(shop.take(params["after"], owner)) if params.get("after") else None
    check_together(
        apparel.way,
        loop=loop,
        after=before is not None,
        path=path is not None,
        in_place=in_place,
        pins=bool(pins),
    )
    apparel.check(character, float(params["seconds"]))
    on_bones = apparel.on_bones(character, params.get("handles") != "rig", path is not None or bool(pins))
    stages = _stages(params.get("without", ()))
    how: dict[str, Any] = {
        "seconds": float(params["seconds"]), "mesh_feature": handles.features, "loop": loop,
        "after": None if before is None else reference_of(before), "guidance": params.get("guidance"),
        "path": reference_path(path, anatomy), "anyway": bool(params.get("anyway")),
        "body": None if on_bones else anatomy,
    }  # fmt: skip

    def fitted(motion: HandleMotion, draft: bool) -> Take:
        if on_bones and not draft:
            move = apply_simulated if apparel.way == "simulate" else apply_rigged
            return apparel.put_on(move(motion, character, in_place=in_place, stages=stages), report)
        body = apply_motion(
            motion, anatomy, loop=loop, in_place=in_place, after=before, path=path, pins=pins,
            stages=DRAFT_STAGES if draft else stages,
        )  # fmt: skip
        return body if draft else apparel.put_on(body, report)

    prompts = [params["script"]] * len(seeds)
    if params.get("draft", True):
        report("draft", 0.02)
        quick = generate(prompts[:1], seed=seeds[:1], steps=DRAFT_STEPS, candidates=1, **how)
        report("draft", 0.06)
        partly({"take": takes[0], **shop.keep(fitted(quick[0], True), takes[0], owner, draft=True)})
    motions = generate(
        prompts, seed=seeds, steps=params.get("steps"), candidates=int(params.get("candidates", 3)),
        progress=lambda stage, done: report(stage, 0.1 + 0.6 * done), **how,
    )  # fmt: skip
    for number, (motion, name) in enumerate(zip(motions, takes, strict=True)):
        report("fit", 0.7 + 0.3 * number / len(takes))
        partly({"take": name, "state": "done", **shop.keep(fitted(motion, False), name, owner)})
    return {"takes": takes}


def _handles_take(shop: Workspace, params: Params) -> Animation:
    return _of_handles(shop.take(params["parent"], params["character"]))


def _of_handles(take: Take) -> Animation:
    body = body_of(take)
    if not isinstance(body, Animation):
        raise OptionError("this take moves the bones of the file; make one that moves handles to change it")
    return body


def _edit(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """A take with parts of another kept, for each seed."""
    from bunraku.pipelines.apply import GENERATED_STAGES
    from bunraku.pipelines.edit import edit

    parent, apparel = _handles_take(shop, params).at(FPS), Apparel.of(params)
    _, pins = _directed(params)
    poses = [float(pose["time"]) for pose in params.get("poses", ())]
    for pose in params.get("poses", ()):
        if pose.get("take") and (pose["take"] != params["parent"] or float(pose["at"]) != float(pose["time"])):
            source = shop.take(pose["take"], params["character"])
            parent = _with_pose(parent, source, float(pose["time"]), float(pose["at"]))
    takes, seeds = params["takes"], params["seeds"]
    how: dict[str, Any] = {
        "keep": params.get("keep", ()), "span": params.get("span"), "poses": poses, "pins": pins,
        "steps": params.get("steps"), "guidance": params.get("guidance"), "anyway": bool(params.get("anyway")),
        "stages": _stages(params.get("without", ())) or GENERATED_STAGES,
    }  # fmt: skip
    for number, (name, seed) in enumerate(zip(takes, seeds, strict=True)):

        def told(stage: str, done: float, number: int = number) -> None:
            report(stage, (number + 0.9 * done) / len(takes))

        made = apparel.put_on(edit(parent, params["prompt"], seed=int(seed), progress=told, **how), report)
        partly({"take": name, "state": "done", **shop.keep(made, name, params["character"])})
    return {"takes": takes}


def _with_pose(clip: Animation, source: Take, time: float, at: float) -> Animation:
    """The clip with one frame taken from another at that one's place in it, heading and way of the clip kept."""
    from bunraku.core.travel import placed_at
    from bunraku.pipelines.apply import reference_of

    source = _of_handles(source)
    frame = min(round(time * clip.fps), len(clip.motion) - 1)
    there = min(round(at * source.fps), len(source.motion) - 1)

    def patched(motion: HandleMotion, other: HandleMotion) -> HandleMotion:
        one = placed_at(other.take(slice(there, there + 1)), 0, motion, frame)
        arrays = {name: np.array(getattr(motion, name)) for name in HandleMotion.arrays}
        for name, array in arrays.items():
            array[frame] = getattr(one, name)[0]
        return motion.with_arrays(arrays)

    return Animation(
        clip.character, clip.handles, patched(clip.motion, source.motion),
        patched(reference_of(clip), reference_of(source)),
    )  # fmt: skip


def _bend(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """A take bent to its pins, with nothing generated."""
    from bunraku.retarget.stages.pins import meet_pins

    parent = _handles_take(shop, params)
    report("fit", 0.2)
    _, pins = _directed(params)
    met = meet_pins(parent.motion, Anatomy.of(parent.character, parent.handles), pins)
    made = Apparel.of(params).put_on(Animation(parent.character, parent.handles, met, parent.reference), report)
    (name,) = params["takes"]
    partly({"take": name, "state": "done", **shop.keep(made, name, params["character"])})
    return {"takes": [name]}


def _dress(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """A take of the same motion whose apparel moves otherwise."""
    owner, (name,) = params["character"], params["takes"]
    parent, (_, handles) = shop.take(params["parent"], owner), shop.character(owner)
    made = dressed_anew(
        parent, Apparel.of(params), handles, in_place=bool(params.get("in_place")),
        stages=_stages(params.get("without", ())), report=report,
    )  # fmt: skip
    partly({"take": name, "state": "done", **shop.keep(made, name, owner)})
    return {"takes": [name]}


def _transfer(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """A take from a motion of a file."""
    from bunraku.pipelines.transfer import transfer

    owner, (name,) = params["character"], params["takes"]
    character, handles = shop.character(owner)
    file = shop.place("takes", name) / params["file"]
    apparel = Apparel.of(params)
    apparel.check(character, 0)
    take = None
    if apparel.way != "rigid" or params.get("onto") == "auto":
        take = transfer(character, file, apparel="simulate" if apparel.way == "simulate" else "rigid", progress=report)
    if not isinstance(take, RigAnimation):  # on the handles that the studio shows
        take = transfer(character, file, onto="handles", handles=handles, progress=report)
    assert isinstance(take, Animation | RigAnimation)
    partly({"take": name, "state": "done", **shop.keep(apparel.put_on(take, report), name, owner)})
    return {"takes": [name]}


def _export(shop: Workspace, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """A take as a file of another program."""
    from bunraku.io.registry import check_writer

    target = shop.place("exports", params["export"]) / params["file"]
    check_writer(target)
    report("write", 0.1)
    take = shop.take(params["take"], params["character"])
    options = {} if target.suffix in (".npz", ".vmd") else {"fps": float(params.get("fps", 30))}
    if isinstance(take, Dressed):
        (take.body if target.suffix in BODIES else take.points).save(target, **options)
    else:
        take.save(target, **options)
    return {"export": params["export"], "bytes": target.stat().st_size}


TASKS: dict[str, Callable[[Workspace, Params, Report, Partly], dict[str, Any]]] = {
    "open": _open,
    "animate": _animate,
    "edit": _edit,
    "bend": _bend,
    "dress": _dress,
    "transfer": _transfer,
    "export": _export,
}


def run_task(shop: Workspace, task: str, params: Params, report: Report, partly: Partly) -> dict[str, Any]:
    """Run a task of `TASKS`.

    Args:
        shop: What it works with.
        task: Its name.
        params: What it takes.
        report: Called with a stage's name and the share done.
        partly: Called with what is there before the end.

    Raises:
        OptionError: There is no such task, or it cannot be done.
    """
    if task not in TASKS:
        raise OptionError(f"there is no task '{task}'")
    return TASKS[task](shop, params, report, partly)

"""Short faces of the pipeline (`pipelines.animator`): `rig`, `generate`, `animate`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, TypedDict, Unpack, overload

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animated import AnimatedCharacter
from bunraku.core.character import Character, Handles
from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import HandleMotion
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests.apparel import Apparel
from bunraku.pipelines.requests.constraints import Constraints
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku.retarget.fit import Stages
from bunraku.retarget.stages.pins import Pin

__all__ = ["animate", "generate", "rig", "with_skeleton"]

Progress = Callable[[str, float], None]


def rig(
    character: Character, *, handles: Literal["predict", "rig"] = "predict", progress: Progress | None = None
) -> Handles:
    """The handles of a character (Eq. 1 of TapMo): positions h, skinning weights s and the mesh feature f_phi.

    Args:
        character: Any mesh, +Y up and facing +Z.
        handles: "predict" them from the shape alone, or take those of the file's own "rig", told by the names of its
            bones.
        progress: Called with a stage's name and the share done, 0 to 1.

    Raises:
        CharacterError: The handles are to be the rig's, and there is none, or its bones have no telling names.
        OptionError: `handles` is neither.
        WeightsError: The shipped weights are missing or broken.
    """
    return Animator.shipped(progress).handles(character, handles)


def with_skeleton(
    character: Character,
    names: Literal["mixamo", "vrm", "unreal"],
    *,
    handles: Handles | Literal["predict", "rig"] = "predict",
    progress: Progress | None = None,
) -> Character:
    """A person's mesh in a T-pose on a tree of joints that engines' humanoid retargeting takes; `animate` then moves
    these, and `save_character` writes them.

    Args:
        character: A person, +Y up and facing +Z.
        names: Whose names the joints get.
        handles: The character's handles, of which the joints are made, or how to make them (see `rig`).
        progress: Called with a stage's name and the share done, 0 to 1.

    Raises:
        CharacterError: It is no person.
        OptionError: There are no names of this kind.
        WeightsError: The shipped weights are missing or broken.
    """
    from bunraku.retarget.engine_skeleton import on_skeleton

    return on_skeleton(Anatomy.of(character, Animator.shipped(progress).handles(character, handles)), names)


class _Generating(TypedDict, total=False):
    """Keyword arguments of `generate`."""

    seconds: float
    seed: int | Sequence[int]
    steps: int | None
    guidance: float | None
    mesh_feature: object | None
    loop: bool
    after: HandleMotion | None
    path: GroundPath | None
    candidates: int
    body: Anatomy | None
    force: bool
    progress: Progress | None


@overload
def generate(prompt: str, **how: Unpack[_Generating]) -> HandleMotion: ...


@overload
def generate(prompt: list[str] | tuple[str, ...], **how: Unpack[_Generating]) -> list[HandleMotion]: ...


def generate(
    prompt: str | list[str] | tuple[str, ...],
    *,
    seconds: float = 6.0,
    seed: int | Sequence[int] = 0,
    steps: int | None = None,
    guidance: float | None = None,
    mesh_feature: object | None = None,
    loop: bool = False,
    after: HandleMotion | None = None,
    path: GroundPath | None = None,
    candidates: int = 3,
    body: Anatomy | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> HandleMotion | list[HandleMotion]:
    """Handle motions of the reference body from sentences (Eq. 2 of TapMo).

    Args:
        prompt: What the character does, in English or a language of `language.words`; several sentences in a row with
            their seconds ("walks:4; jumps:2; waves:3"); or a list of such prompts, which are made in one batch.
        seconds: Length [s], 0.5 to 120; what prompts without seconds of their own share.
        seed: The same seed and version give the same motion. One number gives each prompt of a list noise of its own,
            the first as when it is alone; a list has one for each.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        mesh_feature: f_phi of the character, shape (448,); None generates for no mesh in particular.
        loop: Make a loop: the last frame is the first again, at another place where the motion travels.
        after: Motion of the reference body whose last pose is the first of the new motion.
        path: What the root follows on the ground, in metres of the reference body.
        candidates: How many motions are drawn for each that is given back, the one that the ranker likes best, 1 to
            16. A motion that follows another is drawn once.
        body: The anatomy of the character that is to be moved: sentences are taken as such a body can, so that a fish
            swims where the sentence says walk. `mesh_feature` is that of its handles where it is None.
        force: Generate even where no movement of a sentence is understood.
        progress: Called with a stage's name and the share done.

    Raises:
        OptionError: A prompt is empty, too long or not understood, a length is out of range, or a loop is to follow
            another motion.
        MotionError: `after` is no motion of the reference body at 20 frames a second.
        WeightsError: The shipped weights are missing or broken.
    """
    prompts = [prompt] if isinstance(prompt, str) else list(prompt)
    if not prompts:
        return []
    sampling = Sampling(seconds, seed if isinstance(seed, int) else 0, steps, guidance, candidates)
    constraints = Constraints.of(loop=loop, after=after, path=path)
    requests = [Request(one, sampling, constraints, force=force) for one in prompts]
    motions = Animator.shipped(progress).generate(requests, seed, mesh_feature, body)
    return motions[0] if isinstance(prompt, str) else motions


def animate(
    character: Character,
    prompt: str,
    *,
    seconds: float = 6.0,
    seed: int = 0,
    steps: int | None = None,
    guidance: float | None = None,
    handles: Handles | Literal["predict", "rig"] = "predict",
    apparel: str = "none",
    stiffness: float = 1.0,
    gravity: float = 1.0,
    loop: bool = False,
    in_place: bool = False,
    after: HandleMotion | AnimatedCharacter | None = None,
    path: GroundPath | None = None,
    pins: Sequence[Pin] = (),
    stages: Stages | None = None,
    candidates: int = 3,
    force: bool = False,
    rig: Literal["auto", "own", "handles"] = "auto",
    progress: Progress | None = None,
) -> AnimatedCharacter:
    """Make a character do what a sentence says.

    Args:
        character: Any mesh, +Y up and facing +Z.
        prompt: What it does, in English or a language of `language.words`; or several sentences in a row with their
            seconds: "walks:4; jumps:2; waves:3". A body that is no person's does it as its own kind does, whoever is
            named: "a person walks" makes a dog walk on four legs.
        seconds: Length [s], 0.5 to 120; what sentences without seconds of their own share.
        seed: The same seed and version give the same animation.
        steps: Sampling steps; None takes the default.
        guidance: Classifier-free guidance scale; None takes the default.
        handles: The character's handles, or how to make them: "predict" or "rig" (see `rig`).
        apparel: "none" (or "rigid") moves hair and clothes with the body; "simulate" moves the bones of the character's
            own rig, and hair and clothes by the rigid bodies or springs of its MMD or VRM file, or else by their own
            bones; "learn" moves by a network what it takes to be apparel of any mesh, or what a mask says, named by its
            file; "auto" simulates where the file has physics or such bones and learns where the mesh has apparel.
        stiffness: Factor on how stiff apparel is, 0.001 to 1000.
        gravity: Factor on the gravity of apparel that is simulated, 0 to 10.
        loop: Make a loop: the last pose is the first again, at another place where the motion travels.
        in_place: Take the travel over the ground out, as game engines want it that move the character themselves.
        after: Start in the last pose of this: an animation of the same character, or a motion of the reference body.
        path: What the root follows on the ground, in the character's metres; the clip starts where the path does.
        pins: Where hands and feet are at some times, in the world of the clip.
        stages: Which stages fit the motion to the character; `pipelines.apply.GENERATED_STAGES` when None.
        candidates: How many motions are drawn, of which the ranker chooses the best, 1 to 16.
        force: Animate even where no movement of a sentence is understood.
        rig: What moves: "own" the bones of the file's skeleton, "handles" the 30 handles, "auto" the bones where they
            are understood as those of a person, of four legs or of a bird and no handles are requested, and handles
            otherwise.
        progress: Called with a stage's name and the share done, 0 to 1.

    Returns:
        An `Animation` or, where its own bones move it, a `RigAnimation`, at 20 frames a second; at 30 where apparel is
        simulated, and a `PointAnimation` where it is learned.

    Raises:
        OptionError: The prompt is empty, too long or not understood, the length is out of range, a loop is to follow
            another clip, moving apparel is to be looped, to follow a clip, or simulated to be moved by handles, a path
            is to be looped, walked on the spot or to follow a clip, or a pin cannot be met.
        CharacterError: `handles` are not 30, or cannot be taken from the rig; or there are no physics to simulate.
        WeightsError: The shipped weights are missing or broken.
    """
    request = Request(
        prompt, Sampling(seconds, seed, steps, guidance, candidates),
        Constraints.of(loop=loop, in_place=in_place, after=after, path=path, pins=pins),
        Apparel(apparel, stiffness, gravity),
        stages, "predict" if handles is None else handles, force, rig,
    )  # fmt: skip
    return Animator.shipped(progress)(character, request)

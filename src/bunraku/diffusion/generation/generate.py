"""From sentences to handle motions: what `bunraku.generate` and `bunraku.animate` call."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.ground_path import GroundPath
from bunraku.core.motion import HandleMotion
from bunraku.core.travel import moved
from bunraku.diffusion.features import decode
from bunraku.diffusion.generation.drawing import GUIDANCE, STEPS, Drawing, draw_candidates, frames_of, way_of
from bunraku.errors import OptionError
from bunraku.language.parse import clauses_of
from bunraku.language.sentence import Clause

if TYPE_CHECKING:
    from bunraku.diffusion.examples.guidance_examples import GuidanceExamples
    from bunraku.diffusion.examples.guide import GuidanceExample
    from bunraku.diffusion.generation.ranking import Drawn

__all__ = ["GUIDANCE", "STEPS", "Drawing", "adapt", "generate_motion", "generate_motions"]

_APART = 1_000_003
"""Between the noise of a motion's candidates, so that none is that of another motion of the batch."""


def generate_motion(prompt: str, seconds: float, *, seed: int = 0, **sampling: Any) -> HandleMotion:
    """A handle motion of the reference body from a sentence (Eq. 2 of TapMo), at the model's 20 frames a second.

    Args:
        prompt: What the character does, in English, at most 1,000 characters, of which some 30 words are read.
        seconds: Length [s].
        seed: The same seed and version give the same motion.
        sampling: See `Drawing`.

    Raises:
        OptionError: The prompt or a setting is outside what can be done.
        WeightsError: The weights are missing or broken.
    """
    return generate_motions([clauses_of([(prompt, seconds)])], seeds=seed, **sampling)[0]


def generate_motions(
    scripts: Sequence[Sequence[Clause]],
    *,
    seeds: int | Sequence[int] = 0,
    loop: bool = False,
    path: GroundPath | None = None,
    **sampling: Any,
) -> list[HandleMotion]:
    """Handle motions of the reference body, all in one batch, each from one clause or several in a row.

    Args:
        scripts: For each motion its clauses.
        seeds: One for each motion; a single number gives each motion noise of its own, the first as when it is alone.
        loop: Make loops: each motion's last frame is its first again, at another position where it travels.
        path: What the root follows, in metres of the reference body; each motion then starts where the path does. Who
            goes backwards in the first clause looks back along it.
        sampling: See `Drawing`.

    Raises:
        OptionError: A length or a setting is outside what can be done.
        WeightsError: The weights are missing or broken.
    """
    how = Drawing(**sampling)
    for clause in (clause for script in scripts for clause in script):
        if not (math.isfinite(clause.seconds) and clause.seconds > 0):
            raise OptionError(f"a motion needs a length of more than 0 seconds, not {clause.seconds:g}")
    if not isinstance(seeds, int) and len(seeds) != len(scripts):
        raise OptionError(f"{len(scripts)} motions need as many seeds, not {len(seeds)}")
    if not scripts:
        return []

    from bunraku.diffusion.examples.guidance_examples import GuidanceExamples
    from bunraku.diffusion.generation.texts import Texts
    from bunraku.diffusion.sampling.classifier_guidance import Critic
    from bunraku.diffusion.sampling.windows import drawn_noise
    from bunraku.nn.threads import one_thread

    if how.progress:
        how.progress("generate", 0.0)
    networks = how.networks
    how = replace(how, held=networks)
    model = how.denoiser
    noise = drawn_noise(seeds, len(scripts))
    plain = 0 if how.all_led else 1  # candidates of a turn that start from no example
    pack = networks.examples if how.candidates > plain and how.examples else None
    critic = networks.critic if how.classifier_guidance else None
    texts = Texts.of(networks, scripts, how.candidates > 1, pack is not None, critic)
    known = None if pack is None else GuidanceExamples(pack, texts.shown)
    if known is not None and not loop:
        scripts = [[part for clause in script for part in known.parted(clause)] for script in scripts]
    if known is not None and how.note:
        for told in dict.fromkeys(_left_out(known, clause) for script in scripts for clause in script):
            if told:
                how.note(told)
    guides = (
        None
        if critic is None
        else Critic(critic, {text: vector.astype(np.float32) for text, vector in texts.guided.items()})
    )

    def example(row: int, index: int) -> tuple[GuidanceExample | None, GuidanceExample | None]:
        """What a candidate starts from, and what the gestures do that are made at the same time."""
        attempt, number = divmod(index, how.candidates)
        if known is None or (loop and len(scripts[row]) > 1):
            return None, None
        lengths = frames_of([clause.seconds for clause in scripts[row]], model.config.fps)
        whole = [clause if known.shows(clause) else clause.body for clause in scripts[row]]
        second = [clause.meanwhile or clause for clause in scripts[row]]
        script, gestures = (list(zip(clauses, lengths, strict=True)) for clauses in (whole, second))
        if number < plain and not known.unranked(script) and not known.unranked(gestures):
            return None, None
        turn = attempt * (how.candidates - plain) + max(number - plain, 0)
        return known.of(script, noise[row], turn), known.of(gestures, noise[row], turn)

    def draw(rows: list[int], indices: list[int]) -> list[Drawn]:
        pairs = [(noise[row][0], noise[row][1] + _APART * index) for row, index in zip(rows, indices, strict=True)]
        again = how if not any(index >= how.candidates for index in indices) else replace(how, progress=None)
        examples = [example(row, index) for row, index in zip(rows, indices, strict=True)]
        some = [scripts[row] for row in rows]
        return draw_candidates(texts, some, pairs, again, loop, path, examples, guides)

    rows = list(range(len(scripts)))
    if how.candidates > 1:
        from bunraku.diffusion.generation.ranking import choose, script_scores

        def score(drawn: Sequence[Drawn]) -> np.ndarray:
            with one_thread():
                motions = [one.motion for one in drawn]
                return script_scores(networks.ranker, texts.ranked, motions, [one.script for one in drawn])

        found = choose(draw, len(scripts), how.candidates, score)
    else:
        found = draw(rows, [0] * len(rows))
    own = how.of_body(model)
    motions = []
    for one, script in zip(found, scripts, strict=True):
        made = decode(one.motion, model.config.fps).of_own_body(own)
        if path is not None:
            x, z, heading = way_of(path, len(made), model.config.fps, script)[0]
            made = moved(made, heading, np.array([x, 0, z]))
        motions.append(adapt(made, one.adaptation))
    return motions


def _left_out(known: GuidanceExamples, clause: Clause) -> str:
    """What of a clause no motion shows, or no gesture does, in a line; "" for nothing."""
    word, action = known.unseen(clause)
    if word:
        return f"no motion of '{word}' is known; this is one of '{action}'"
    lacking = ", ".join(f"'{word}'" for word in known.lacking(clause))
    if not lacking:
        return ""
    return f"no gesture of '{clause.text}' has {lacking}; the network makes the motion, and may leave that out"


def adapt(motion: HandleMotion, adaptation: np.ndarray) -> HandleMotion:
    """The motion with the adaptation added to its local translations (section 3.2 of TapMo).

    Args:
        motion: N frames of K handles.
        adaptation: Offsets [m], shape (N, K, 3); the root's is left out.
    """
    if not adaptation.any():
        return motion
    translations = motion.translations + adaptation
    translations[:, 0] = 0
    return replace(motion, translations=translations)

"""Does "a person A, then B" do A and then B? The network alone against clauses that are generated one by one, as a
Markdown table.

    python benchmarks/clauses.py [--pairs 48] [--seconds 6] [--seed 0]

Pairs of the actions below are drawn. The extractor of `bunraku evaluate motion` looks at the first and the second half
of each motion, without half a second at the seam, and names the nearest of all actions. Columns: how often the first
half is A, the second B, and both.
"""

from __future__ import annotations

import argparse
import os

ACTIONS = (
    "walks forward", "runs", "jumps", "waves with the right hand", "dances", "kicks", "walks backward", "sits down",
    "bows", "throws a ball",
    "turns around", "punches", "does jumping jacks", "picks something up", "crawls", "hops on one leg",
    "does a cartwheel", "swims",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=48)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = str(args.threads)  # read when the libraries load, so before any import of them

    import numpy as np

    from bunraku.generation.extractor import embed_motions, load_extractor
    from bunraku.generation.features import encode
    from bunraku.generation.generate import generate_motions
    from bunraku.generation.networks import Networks
    from bunraku.language.parse import clauses_of, parse
    from bunraku_lab.nn.checkpoints import lab_checkpoint
    from bunraku_lab.nn.text import embed_sentences

    extractor = load_extractor(lab_checkpoint("extractor"))
    sentences = [f"a person {action}" for action in ACTIONS]
    known = embed_sentences(extractor, Networks().encoder, sentences)
    table = np.stack([known[sentence] for sentence in sentences])
    random = np.random.default_rng(args.seed)
    pairs = [random.choice(len(ACTIONS), 2, replace=False) for _ in range(args.pairs)]
    prompts = [f"a person {ACTIONS[a]}, then {ACTIONS[b]}" for a, b in pairs]

    def nearest(motions: list[np.ndarray]) -> np.ndarray:
        vectors = embed_motions(extractor, motions)
        return np.linalg.norm(vectors[:, None] - table, axis=-1).argmin(1)

    print("| | first | second | both |\n| --- | --- | --- | --- |")
    ways = {
        "the network alone": [clauses_of([(prompt, args.seconds)]) for prompt in prompts],
        "by clauses": [parse(prompt, args.seconds).clauses for prompt in prompts],
    }
    for name, scripts in ways.items():
        features = []
        for start in range(0, len(scripts), 8):
            seeds = [args.seed + index for index in range(start, min(start + 8, len(scripts)))]
            features += [encode(motion) for motion in generate_motions(scripts[start : start + 8], seeds=seeds)]
        half, gap = len(features[0]) // 2, 5
        first = nearest([values[: half - gap] for values in features]) == [a for a, _ in pairs]
        second = nearest([values[half + gap :] for values in features]) == [b for _, b in pairs]
        print(f"| {name} | {first.mean():.0%} | {second.mean():.0%} | {(first & second).mean():.0%} |", flush=True)


if __name__ == "__main__":
    main()

// The sentences of the timeline, and those of a take: what is shown where a take is chosen.

import { EMPTY, MOST_LETTERS } from "./schema";
import type { Doc, Sentence, Take } from "./types";

export const SHORTEST = 0.5;
export const LONGEST = 120;
export const SAY = "type what the character does, such as: walks forward, then waves";

export const inRange = (seconds: number): number => Math.min(Math.max(seconds, SHORTEST), LONGEST);

/** Whether no sentences made the take: it is the motion of a file, or was played live. */
const unwritten = (take: Take): boolean => take.how === "transfer" || take.how === "live";

/** What the timeline holds where a take is chosen; of a motion without sentences an empty sentence of its length. */
export function scriptOf(take: Take | null): Sentence[] {
  if (!take) {
    return EMPTY.script;
  }
  if (unwritten(take)) {
    return [{ text: "", seconds: inRange(take.seconds ?? 4) }];
  }
  const parts = take.script.map((part, _, { length }) => ({
    ...part,
    seconds: inRange(part.fits && length === 1 && take.seconds ? take.seconds : part.seconds),
  }));
  return parts.length ? parts : EMPTY.script;
}

/** Whether the take has no sentences and nothing was typed since it was chosen. */
export const fromFile = (take: Take | null, doc: Doc): take is Take =>
  take !== null && unwritten(take) && doc.script.length === 1 && !doc.script[0]?.text;

/** A script with another length of a sentence; null for what fits what is done. */
export function lasting(script: Sentence[], number: number, seconds: number | null): Sentence[] {
  return script.map(({ fits: _, ...part }, place) =>
    place === number ? (seconds === null ? { ...part, fits: true } : { ...part, seconds }) : script[place]!,
  );
}

export interface Block {
  text: string;
  /** Where it begins [s]. */
  from: number;
  seconds: number;
  /** Which sentence it is; null for a motion of a file, which is not changed here. */
  number: number | null;
  /** Whether it is a clip of the library. */
  clip: boolean;
}

/** The blocks of the timeline: the sentences one after the other, or the file that the take came from. */
export function blocksOf(doc: Doc, take: Take | null): Block[] {
  if (fromFile(take, doc)) {
    return [{ text: take.script[0]?.text || "a motion", from: 0, seconds: take.seconds ?? 0, number: null, clip: false }];
  }
  let from = 0;
  return doc.script.map(({ text, seconds, clip }, number) => {
    const block = { text: clip ?? text, from, seconds, number, clip: Boolean(clip) };
    from += seconds;
    return block;
  });
}

/** Why this cannot be made, "" where it can. */
export function wrongWith(script: Sentence[]): string {
  const long = script.find((part) => part.text.length > MOST_LETTERS);
  if (long) {
    return tooLong(long.text);
  }
  return script.every((part) => part.clip || part.text.trim()) ? "" : SAY;
}

export const tooLong = (text: string): string =>
  `the sentence has ${text.length.toLocaleString("en")} letters, at most ${MOST_LETTERS.toLocaleString("en")} are taken: shorten it`;

/** Points on the floor of a text such as "0,0 1,2 3,2"; none where it has fewer than two. */
export function readPath(text: string): [number, number][] {
  const points = text.trim().split(/\s+/).map((point) => point.split(",").map(Number));
  const path = points.filter((point): point is [number, number] => point.length === 2 && point.every((one) => Math.abs(one) <= 500));
  return path.length === points.length && path.length > 1 ? path.slice(0, 200) : [];
}

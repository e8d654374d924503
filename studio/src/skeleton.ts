// Which joints of a character its bones are between.

import { Color, type Bone } from "three";
import type { Chain, Character } from "./types";

/** The parent of each of the 30 handles (src/bunraku/core/body/layout.py). */
export const PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21, 15, 15, 9, 9, 0, 28];

/** Pairs of joints between which bones are drawn: of the file's own, or of the handles by the parts that they play. */
export function skeletonOf(one: Character, skin: "handles" | "bones", bones: readonly Bone[]): [number, number][] {
  if (skin === "bones") {
    return bones.flatMap((bone, joint): [number, number][] => {
      const parent = bones.indexOf(bone.parent as Bone);
      return parent > 0 ? [[parent, joint]] : []; // the first joint stands still
    });
  }
  const { roles = [], used = [] } = one;
  const plays = new Map(used.map((joint) => [roles[joint] ?? joint, joint]));
  return used.flatMap((joint): [number, number][] => {
    let role = PARENTS[roles[joint] ?? joint] ?? -1;
    while (role >= 0 && !plays.has(role)) {
      role = PARENTS[role] ?? -1;
    }
    const from = plays.get(role);
    return from === undefined || from === joint ? [] : [[from, joint]];
  });
}

const KINDS = ["hair", "skirt", "cape", "sleeve", "tail", "ear", "ribbon", "strand"];
/** Parts that never swing have the hues of chains that no part is called after. */
const STILL: Record<string, string> = { prop: "ear", accessory: "ribbon", ground: "strand" };
/** What is neither hair nor clothes. */
export const BARE = new Color(0xb9b4ac);

export function kindColour(kind: string): Color {
  const number = KINDS.indexOf(STILL[kind] ?? kind);
  return number < 0 ? BARE : new Color().setHSL(((number * 137.508) % 360) / 360, 0.75, 0.45);
}

/** A chain as it is drawn: the bones that it is made of, where the model has them, and how it lies at rest. */
export interface Strand {
  bones: number[];
  chain: Chain;
  colour: Color;
}

/** The chains of a character; `count` bones of its model are there, of which the handles are first, then the links of all
 * chains, then their ends (src/bunraku/apparel/chains/chain_rig.py). */
export function strandsOf(one: Character, count: number): Strand[] {
  const chains = one.chains ?? [];
  const handles = one.positions?.length ?? 0;
  const links = chains.reduce((sum, chain) => sum + chain.points.length - 1, 0);
  let at = handles;
  return chains.map((chain, number) => {
    const own = chain.points.length - 1;
    const bones = Array.from({ length: own }, (_, link) => at + link).concat(handles + links + number);
    at += own;
    return { bones: count === handles + links + chains.length ? bones : [], chain, colour: kindColour(chain.kind) };
  });
}

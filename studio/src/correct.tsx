// A body corrected by hand: joints are dragged to where they belong, and parts are given another kind.

import { signal } from "@preact/signals";
import { generate } from "./actions";
import { send } from "./api";
import { KINDS, Parts, picked, Swatch, touched } from "./parts";
import { attempt, character, characters, correcting, ended, remember } from "./state";
import type { Body, Character, Said, Vec3 } from "./types";

const MOST = 12; // parts that are listed

/** What is shown before the studio has answered, of a version of the character. */
const moved = signal<{ version: number; joints: Record<string, Vec3> } | null>(null);
const alike = signal(true);
const chosen = signal("");
let changed = false; // something was corrected since it was begun

/** The joints as they are shown. */
export function jointsOf(one: Character): Body["joints"] {
  const own = moved.value?.version === one.version ? moved.value.joints : {};
  return (one.body?.joints ?? []).map((joint) => ({ ...joint, point: own[joint.name] ?? joint.point }));
}

const mirrored = (name: string): string =>
  name.startsWith("left_") ? name.replace("left_", "right_") : name.startsWith("right_") ? name.replace("right_", "left_") : "";

/** Say all of it, and wait until the character stands as it says. */
async function tell(id: string, said: Said): Promise<void> {
  const made = await send<{ job: string }>("PUT", `/characters/${id}/body`, said);
  changed = true;
  await ended(made.job);
}

async function correct(name: string, said: Said): Promise<void> {
  const one = character.value;
  const before = one?.body?.said;
  if (one && before) {
    await attempt(async () => {
      await tell(one.id, said);
      remember({ name, undo: () => tell(one.id, before), redo: () => tell(one.id, said) });
    });
    moved.value = null;
  }
}

/** A joint was dragged, or its place was typed. */
export async function moveJoint(name: string, point: Vec3): Promise<void> {
  const one = character.value;
  const said = one?.body?.said;
  if (!one || !said || one.state !== "ready") {
    return;
  }
  chosen.value = name;
  const other = mirrored(name);
  const both = alike.value && one.body?.joints.some((joint) => joint.name === other);
  const joints: Record<string, Vec3> = { [name]: point, ...(both ? { [other]: [-point[0], point[1], point[2]] as Vec3 } : {}) };
  moved.value = { version: one.version, joints };
  await correct("move a joint", { ...said, joints: { ...said.joints, ...joints } });
}

/** What is at a point is of a kind. */
export function sayKind(at: Vec3, kind: string): void {
  const said = character.value?.body?.said;
  if (said) {
    const rest = said.part.filter((each) => String(each.at) !== String([at]));
    void correct("say what a part is", { ...said, part: [...rest, { kind, at: [at] }] });
  }
}

/** All parts that are there are of a kind, such as a ship's, which has no limbs. */
function sayAll(one: Character, kind: string): void {
  const { body, dress } = one;
  if (body) {
    void correct("say what all parts are", { ...body.said, part: [{ kind, at: [...body.parts, ...(dress ?? [])].map((part) => part.at) }] });
  }
}

export const plain = (name: string): string => name.replaceAll("_", " ");

function Place({ joint, free }: { joint: Body["joints"][number]; free: boolean }) {
  return (
    <div class="pin" role="group" aria-label={plain(joint.name)}>
      <span>{plain(joint.name)}</span>
      {(["x", "y", "z"] as const).map((axis, number) => (
        <input
          key={axis}
          type="number"
          step={0.01}
          disabled={!free}
          value={Number((joint.point[number] ?? 0).toFixed(3))}
          aria-label={`${axis} in metres`}
          onChange={(event) => {
            const value = Number(event.currentTarget.value);
            if (Number.isFinite(value)) {
              void moveJoint(joint.name, joint.point.map((old, each) => (each === number ? value : old)) as Vec3);
            }
          }}
        />
      ))}
    </div>
  );
}

export function Correct({ one }: { one: Character }) {
  const { body } = one;
  if (!body) {
    return null;
  }
  if (!correcting.value) {
    return (
      <button
        id="correct"
        onClick={() => {
          changed = false;
          correcting.value = true;
        }}
      >
        Correct its joints and parts
      </button>
    );
  }
  const free = one.state === "ready";
  const joints = jointsOf(one);
  const shown = joints.find((joint) => joint.name === chosen.value) ?? joints[0];
  const dress = one.dress ?? [];
  const parts = [...body.parts, ...dress].slice(0, MOST);
  const spoken = Object.keys(body.said.joints).length + body.said.part.length > 0;
  return (
    <fieldset class="painting">
      <legend>Joints and parts</legend>
      <label class="toggle">
        <input type="checkbox" checked={alike.value} onChange={(event) => (alike.value = event.currentTarget.checked)} /> left and right alike
      </label>
      <Parts one={one} />
      <label class="field">
        <span>joint</span>
        <select id="joint" value={shown?.name} onChange={(event) => (chosen.value = event.currentTarget.value)}>
          {joints.map((joint) => (
            <option key={joint.name} value={joint.name}>
              {plain(joint.name)}
            </option>
          ))}
        </select>
      </label>
      {shown && <Place joint={shown} free={free} />}
      {parts.length > 1 && (
        <label class="field small">
          <span>all parts</span>
          <select id="all-parts" value="" disabled={!free} onChange={(event) => sayAll(one, event.currentTarget.value)}>
            <option value="">as they are</option>
            {KINDS.map((each) => (
              <option key={each}>{each}</option>
            ))}
          </select>
        </label>
      )}
      {parts.map((part, number) => (
        <label
          class="field small"
          key={number}
          onPointerEnter={() => (touched.value = part)}
          onPointerLeave={() => (touched.value = null)}
          onFocusIn={() => (touched.value = part)}
          onFocusOut={() => (touched.value = null)}
        >
          <span>
            {dress.includes(part) && <Swatch kind={part.kind} />} part {number + 1}, {Math.max(1, Math.round(100 * part.area))} %
          </span>
          <select
            value={part.kind}
            disabled={!free}
            onChange={(event) => sayKind(part.at, event.currentTarget.value)}
          >
            {[...new Set([...KINDS, part.kind])].map((kind) => (
              <option key={kind}>{kind}</option>
            ))}
          </select>
        </label>
      ))}
      {spoken && (
        <button class="link" disabled={!free} onClick={() => void correct("take corrections back", { ...body.said, joints: {}, part: [] })}>
          take all corrections back
        </button>
      )}
      <button id="corrected" class="main" disabled={!free} onClick={() => void endCorrecting()}>
        Done
      </button>
    </fieldset>
  );
}

/** Show it in motion again; what was corrected shows in a take that is made anew. */
export async function endCorrecting(): Promise<void> {
  correcting.value = false;
  touched.value = picked.value = null;
  if (changed && characters.value.some((one) => one.id === character.value?.id && one.state === "ready")) {
    changed = false;
    await generate();
  }
}

// Characters as cards, what was guessed of the one that is shown, and the samples.

import { signal } from "@preact/signals";
import { useEffect, useRef, useState } from "preact/hooks";
import { deleteCharacter, openAsMotion, repair, sample, select } from "./actions";
import { Apparel } from "./apparel";
import { bytes } from "./api";
import { Correct } from "./correct";
import { Legend, Parts } from "./parts";
import { about, attempt, change, character, characters, colouring, correcting, doc, unfolded, weightOf } from "./state";
import { Thumbs } from "./thumbs";
import type { Character } from "./types";

/** Which chains there are, in the colours that they are shown in. */
function Kinds({ one }: { one: Character }) {
  const counts = new Map<string, number>();
  one.chains?.forEach((chain) => counts.set(chain.kind, (counts.get(chain.kind) ?? 0) + 1));
  return <Legend counts={new Map([...counts].map(([kind, count]) => [kind, String(count)]))} />;
}

const UNITS: Record<string, string> = { m: "metres", cm: "centimetres", mm: "millimetres", in: "inches" };
const HANDLES =
  "pelvis,left hip,right hip,spine 1,left knee,right knee,spine 2,left ankle,right ankle,spine 3,left foot,right foot,neck,left collar,right collar,head,left shoulder,right shoulder,left elbow,right elbow,left wrist,right wrist,left fingers,right fingers,head top,face,left wing,right wing,tail,tail tip".split(
    ",",
  );

/** The axis at a right angle to two others: where the left side of a character is, of its up and front. */
export function across(up: string, front: string): string {
  const names = ["x", "y", "z"];
  const [a, b] = [names.indexOf(up.slice(1)), names.indexOf(front.slice(1))];
  const third = 3 - a - b;
  const even = (a + 1) % 3 === b;
  const negative = (up[0] === "-") !== (front[0] === "-");
  return `${even !== negative ? "+" : "-"}${names[third] ?? "x"}`;
}

const turned = (axis: string): string => (axis.startsWith("-") ? `+${axis.slice(1)}` : `-${axis.slice(1)}`);

function axis(name: string): string {
  return name.toUpperCase().replace("-", "−");
}

/** What was guessed, each with what repairs it. */
function Chips({ one }: { one: Character }) {
  const chips: preact.ComponentChildren[] = [];
  const { axes, unit, settings } = one;
  const free = one.state === "ready";
  if (axes?.other && !one.sample && (axes.sure < 0.97 || settings.up !== "auto")) {
    const [up, front] = axes.other;
    chips.push(
      <button key="axes" class="chip" disabled={!free} onClick={() => void repair(one, { up, front })} title="turn it">
        {settings.up === "auto" ? `${axis(axes.up)} up, facing ${axis(axes.front)}? ` : ""}turn to {axis(up)} up, facing {axis(front)}
      </button>,
    );
  }
  if (unit && unit.likely && unit.likely !== unit.unit) {
    chips.push(
      <button key="unit" class="chip" disabled={!free} onClick={() => void repair(one, { unit: unit.likely })}>
        {one.height?.toPrecision(3)} m tall: {UNITS[unit.likely] ?? unit.likely}?
      </button>,
    );
  } else if (unit && unit.unit !== "m") {
    chips.push(
      <button key="metres" class="chip" disabled={!free} onClick={() => void repair(one, { unit: "m" })}>
        read as {UNITS[unit.unit] ?? unit.unit}; take as metres
      </button>,
    );
  }
  if (one.rig) {
    const to = settings.handles === "rig" ? "predict" : "rig";
    chips.push(
      <button key="handles" class="chip" disabled={!free} onClick={() => void repair(one, { handles: to })}>
        handles {settings.handles === "rig" ? "of the file's bones; predict them" : "predicted; take the file's bones"}
      </button>,
    );
  }
  return <div class="chips">{chips}</div>;
}

/** Four views of a character whose front is not sure: one click says which it is. */
function Fronts({ one }: { one: Character }) {
  const [views, setViews] = useState<string[]>([]);
  const { axes } = one;
  const there = useRef<HTMLFieldSetElement>(null);
  useEffect(() => there.current?.scrollIntoView({ block: "nearest" }), [views]);
  useEffect(() => {
    let gone = false;
    const thumbs = new Thumbs();
    void attempt(async () => {
      await thumbs.show(`${one.id}:${one.version}`, await bytes(`/characters/${one.id}/mesh.glb?skin=handles`), one.bounds);
      if (!gone) {
        setViews([0, 0.25, 0.5, 0.75].map((side) => thumbs.picture(side).toDataURL()));
      }
      thumbs.end();
    });
    return () => {
      gone = true;
    };
  }, [one.id, one.version]);
  if (!axes) {
    return null;
  }
  const left = across(axes.up, axes.front);
  const fronts = [axes.front, left, turned(axes.front), turned(left)];
  return (
    <fieldset class="fronts" ref={there}>
      <legend>Which is its front?</legend>
      {views.map((view, number) => (
        <button
          key={number}
          class="card"
          disabled={one.state !== "ready"}
          onClick={() => void repair(one, { up: axes.up, front: fronts[number] ?? axes.front })}
        >
          <img src={view} alt={`seen with ${axis(fronts[number] ?? "")} ahead`} />
          <small>this is its front</small>
        </button>
      ))}
    </fieldset>
  );
}

function Fit({ one }: { one: Character }) {
  const free = one.state === "ready";
  const choice = (name: "up" | "front" | "unit", options: string[]) => (
    <label class="field">
      <span>{name}</span>
      <select
        value={one.settings[name]}
        disabled={!free}
        onChange={(event) => void repair(one, { [name]: event.currentTarget.value })}
      >
        {options.map((option) => (
          <option key={option}>{option}</option>
        ))}
      </select>
    </label>
  );
  const axes = ["auto", "+x", "-x", "+y", "-y", "+z", "-z"];
  return (
    <details>
      <summary>how it stands</summary>
      <div class="fields">
        {choice("up", axes)}
        {choice("front", axes)}
        {choice("unit", ["auto", "m", "cm", "mm", "in"])}
      </div>
    </details>
  );
}

/** Whether its front was guessed and might be another. */
const unsure = (one: Character): boolean => !one.sample && Boolean(one.axes?.other) && (one.axes?.sure ?? 1) < 0.97 && one.settings.front === "auto";

function Picture({ one }: { one: Character }) {
  const [url, setUrl] = useState("");
  useEffect(() => {
    if (!one.picture) {
      return undefined;
    }
    let made = "";
    void bytes(`/characters/${one.id}/picture?v=${one.picture}`)
      .then((data) => setUrl((made = URL.createObjectURL(new Blob([data])))))
      .catch(() => undefined);
    return () => URL.revokeObjectURL(made);
  }, [one.id, one.picture]);
  return url ? <img class="strip" src={url} alt="" width={56} height={42} /> : <span class="blank" aria-hidden="true" />;
}

/** Whether what a body is made of is unfolded. */
const body = signal(false);

export function Characters() {
  const motion = useRef<HTMLInputElement>(null);
  const chosen = useRef<HTMLLIElement>(null);
  const now = character.value;
  useEffect(() => chosen.current?.scrollIntoView({ block: "nearest" }), [now?.id, unfolded.value]);
  return (
    <section class="cast" aria-label="characters">
      <div class="panel">
        <p class="hint">
          Drop a character, a motion or a project anywhere on the page.
        </p>
        <ul class="list">
          {characters.value.map((one) => (
            <li key={one.id} ref={one.id === doc.value.character ? chosen : undefined} class={one.id === doc.value.character ? "chosen" : ""}>
              <button class="name pictured" aria-pressed={one.id === doc.value.character} onClick={() => select(one.id)}>
                <Picture one={one} />
                <span>{one.name}</span>
                <small>
                  {one.state === "ready"
                    ? `${one.height?.toPrecision(3)} m tall`
                    : one.state === "opening"
                      ? "opening…"
                      : one.error || one.state}
                </small>
              </button>
              <button class="icon" aria-label={`delete ${one.name}`} onClick={() => void deleteCharacter(one.id)}>
                ×
              </button>
            </li>
          ))}
        </ul>
        {(now?.state === "ready" || (now && correcting.value)) && (
          <>
            <Chips one={now} />
            {unsure(now) && <Fronts one={now} />}
            <details id="body" open={body.value} onToggle={(event) => (body.value = event.currentTarget.open)}>
            <summary>body, hair and clothes</summary>
            <Fit one={now} />
            <div class="fields">
              <label class="field">
                <span>show</span>
                <select
                  id="colouring"
                  value={colouring.value}
                  onChange={(event) => (colouring.value = event.currentTarget.value as typeof colouring.value)}
                >
                  <option value="none">as it is</option>
                  <option value="handles">handles in colour</option>
                  <option value="weights">weights of one handle</option>
                  <option value="skeleton">skeleton</option>
                  {Boolean(now.dress?.length) && <option value="parts">parts in colour</option>}
                  {Boolean(now.chains?.length) && <option value="chains">chains of hair and clothes</option>}
                </select>
              </label>
              {colouring.value === "weights" && (
                <label class="field">
                  <span>handle</span>
                  <select value={String(weightOf.value)} onChange={(event) => (weightOf.value = Number(event.currentTarget.value))}>
                    {(now.used ?? []).map((handle) => (
                      <option key={handle} value={String(handle)}>
                        {HANDLES[now.roles?.[handle] ?? handle] ?? `handle ${handle}`}
                        {now.roles?.[handle] !== handle ? ` (${handle})` : ""}
                      </option>
                    ))}
                  </select>
                </label>
              )}
            </div>
            {now.skeleton && (
              <label class="field">
                <span>what moves</span>
                <select
                  id="rig"
                  value={doc.value.rig}
                  onChange={(event) => change("", { rig: event.currentTarget.value as "handles" | "own" })}
                >
                  <option value="handles">30 handles, which can be pinned and changed</option>
                  <option value="own">its own skeleton of {now.joints} bones</option>
                </select>
              </label>
            )}
            <Correct one={now} />
            <Apparel one={now} />
            {colouring.value === "chains" && !correcting.value && <Kinds one={now} />}
            {colouring.value === "parts" && !correcting.value && <Parts one={now} />}
            <p class="hint">
              <button class="link" onClick={() => motion.current?.click()}>
                take the motion of a GLB or FBX…
              </button>
              <input
                ref={motion}
                type="file"
                hidden
                onChange={(event) => {
                  const file = event.currentTarget.files?.[0];
                  event.currentTarget.value = "";
                  if (file) {
                    void openAsMotion(file);
                  }
                }}
              />
            </p>
            </details>
          </>
        )}
      </div>
      <div class="samples">
        <h2>Samples</h2>
        <ul class="cards">
          {about.value?.samples.map((name) => (
            <li key={name}>
              <button class="card" id={`sample-${name}`} onClick={() => void sample(name)}>
                <img class="strip" src={`sample-${name}.webp`} alt="" width={96} height={72} />
                <span>{name}</span>
              </button>
            </li>
          ))}
        </ul>
      </div>
    </section>
  );
}

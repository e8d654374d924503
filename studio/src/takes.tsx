// Takes: chosen, starred, compared, and what is changed of the one that is chosen.

import { signal } from "@preact/signals";
import { useState } from "preact/hooks";
import { bend, choose, deleteTake, regenerate, remake, replayLink, star } from "./actions";
import { send } from "./api";
import { viewer } from "./stage";
import { attempt, change, changing, character, comparing, doc, ended, instead, interrupted, ownTakes, running, say, take, time, uploading } from "./state";
import type { Character, Take, Vec3 } from "./types";

/** Where one chooses, the sliders begin here. */
const GUIDANCE = 3.5;
const STEPS = 8;
const KEPT = ["legs", "arms", "left arm", "right arm", "torso", "head", "upper body", "lower body", "tail", "wings", "root"];

/** Whether a character may have a part: what not all bodies have is among its joints. */
function owns(one: Character | null, part: string): boolean {
  const extra = { tail: "tail", wings: "wing" }[part];
  return !extra || !one?.body || one.body.joints.some(({ name }) => name.includes(extra));
}

export const PARTS: Record<string, string> = {
  left_hand: "left hand",
  right_hand: "right hand",
  left_foot: "left foot",
  right_foot: "right foot",
};

const factor = (stiffness: number): string => String(Number(stiffness.toPrecision(2)));

export const titleOf = (one: Take): string =>
  one.title ||
  (one.how === "edit"
    ? `${String(one.asked?.["prompt"] ?? "changed")}`
    : one.how === "dress"
      ? `dressed · ${one.script[0]?.text ?? ""}`
    : one.how === "bend"
      ? `pinned · ${one.script[0]?.text ?? ""}`
    : one.how === "mirror" || one.how === "trim"
      ? `${one.how === "mirror" ? "mirrored" : "cut"} · ${one.script.map((part) => part.clip ?? part.text).join("; ")}`
      : one.script.map((part) => part.clip?.replaceAll("-", " ") ?? part.text).join("; "));

/** What distinguishes a take from others of the same title. */
export function whichOf(one: Take): string {
  const origin = one.how === "transfer" ? "from a file" : one.how === "live" ? "played live" : `variation ${one.seed}`;
  const stiff = one.stiffness ? ` · ${factor(one.stiffness)} times as stiff` : "";
  return `${origin} · ${one.seconds?.toFixed(1)} s${stiff}`;
}

function Row({ one }: { one: Take }) {
  const chosen = one.id === doc.value.take;
  const job = running.value.find((each) => each.about.takes?.includes(one.id));
  return (
    <li class={chosen ? "chosen" : ""}>
      <button class="name" aria-pressed={chosen} onClick={() => choose(one.id)}>
        {titleOf(one)}
        <small>
          {one.state === "done"
            ? whichOf(one)
            : one.error || (job ? `${job.stage || one.state} ${Math.round(job.done * 100)} %` : one.state)}
        </small>
        {job && <progress max={1} value={job.done} />}
      </button>
      {!job && (
        <button class="icon star" aria-label={one.star ? "remove the star" : "star"} aria-pressed={one.star} onClick={() => void star(one)}>
          {one.star ? "★" : "☆"}
        </button>
      )}
      {job ? (
        <button class="icon" aria-label="cancel" onClick={() => void attempt(() => send("DELETE", `/jobs/${job.id}`))}>
          ■
        </button>
      ) : (
        <button class="icon" aria-label={`delete ${titleOf(one)}`} onClick={() => void deleteTake(one.id)}>
          ×
        </button>
      )}
    </li>
  );
}

/** Whether what changes a take is unfolded; it stays so from take to take. */
export const changes = signal(false);

/** Pins as numbers: all that dragging a dot in the view does, without a pointer. */
function Pins() {
  const ends = character.value?.ends ?? [];
  const { pins } = doc.value;
  const add = (part: string): void => {
    const position = viewer?.endOf(part);
    if (position) {
      const at = Math.round(time.value * 100) / 100;
      change("pin", { pins: [...pins, { part, time: at, position, hold: 0 }].sort((a, b) => a.time - b.time) });
    }
  };
  const set = (number: number, axis: number, value: number): void => {
    if (Number.isFinite(value)) {
      const position = (pins[number]?.position ?? [0, 0, 0]).map((old, each) => (each === axis ? value : old)) as Vec3;
      change("pin", { pins: pins.map((pin, each) => (each === number ? { ...pin, position } : pin)) });
    }
  };
  return (
    <>
      <div class="chips">
        {ends.map((end) => (
          <button key={end.part} class="chip" onClick={() => add(end.part)}>
            pin {PARTS[end.part] ?? end.part} here
          </button>
        ))}
      </div>
      {pins.map((pin, number) => (
        <div class="pin" key={`${pin.part}@${pin.time}`} role="group" aria-label={`${PARTS[pin.part]} at ${pin.time} s`}>
          <span>
            {PARTS[pin.part]} <small>{pin.time} s</small>
          </span>
          {["x", "y", "z"].map((name, axis) => (
            <input
              key={name}
              type="number"
              step={0.05}
              value={pin.position[axis]}
              aria-label={`${name} in metres`}
              onChange={(event) => set(number, axis, Number(event.currentTarget.value))}
            />
          ))}
          <button class="icon" aria-label={`remove the pin of ${PARTS[pin.part]}`} onClick={() => change("unpin", { pins: pins.filter((one) => one !== pin) })}>
            ×
          </button>
        </div>
      ))}
      {pins.length > 0 && <button onClick={() => void bend()}>Bend to the pins</button>}
    </>
  );
}

/** The span, mirror and the path as fields. */
function Change() {
  const now = doc.value;
  const [cut, setCut] = useState<[number, number]>([0, 0]);
  const length = take.value?.seconds ?? 0;
  const [from, to] = now.span ?? cut;
  const span = (values: [number, number]): void => {
    setCut(values);
    const long = values[1] - values[0] >= 0.1;
    change("select a span", { span: long ? values : null }, { changing: long });
  };
  const field = (name: string, value: number, set: (value: number) => void) => (
    <label class="field small">
      <span>{name}</span>
      <input
        type="number"
        min={0}
        max={length}
        step={0.05}
        value={value}
        onChange={(event) => set(Math.min(Math.max(Number(event.currentTarget.value) || 0, 0), length))}
      />
    </label>
  );
  return (
    <>
      <div class="row-fields">
        {field("from", from, (value) => span([value, Math.max(to, value)]))}
        {field("to", to, (value) => span([Math.min(from, value), value]))}
        <span class="muted">s</span>
      </div>
      <div class="chips">
        <button class="chip" disabled={to - from < 0.1} onClick={() => void regenerate(instead.value)}>
          make this stretch anew
        </button>
        <button class="chip" id="trim" disabled={to - from < 0.1} onClick={() => void remake("cut a take", { trim: [from, to] })}>
          keep only this stretch
        </button>
        <button class="chip" id="mirror" onClick={() => void remake("mirror a take", { mirror: true })}>
          mirror left and right
        </button>
      </div>
    </>
  );
}

export function Takes() {
  const now = doc.value;
  const automatic = now.steps === null && now.guidance === null;
  const all = ownTakes.value;
  return (
    <section class="panel" aria-label="takes">
      <header>
        <h2>Takes</h2>
        <button id="compare" aria-pressed={comparing.value} disabled={all.length < 2} onClick={() => (comparing.value = !comparing.value)} title="C: side by side">
          Compare
        </button>
      </header>
      <Jobs />
      <ul class="list takes">
        {all.map((one) => (
          <Row key={one.id} one={one} />
        ))}
        {!all.length && <li class="hint">no takes yet: type a sentence and press Enter</li>}
      </ul>
      {take.value?.state === "done" && (
        <details open={changing.value || changes.value} onToggle={(event) => (changes.value = event.currentTarget.open)}>
          <summary>change this take</summary>
          <p class="hint">Keep parts of the body, select a stretch of time, or pin poses, hands and feet; the rest is made anew.</p>
          <div class="chips">
            {KEPT.filter((part) => owns(character.value, part)).map((part) => (
              <button
                key={part}
                class="chip"
                aria-pressed={now.keep.includes(part)}
                onClick={() => {
                  const keep = now.keep.includes(part) ? now.keep.filter((each) => each !== part) : [...now.keep, part];
                  change("", { keep }, { changing: true });
                }}
              >
                keep {part === "root" ? "its path" : part}
              </button>
            ))}
          </div>
          <Change />
          {take.value.skin === "handles" && <Pins />}
        </details>
      )}
      <details>
        <summary>how takes are drawn</summary>
        <div class="fields">
          <label class="toggle">
            <input type="checkbox" checked={automatic} onChange={(event) => change("", !event.currentTarget.checked ? { guidance: GUIDANCE, steps: STEPS } : { guidance: null, steps: null })} />
            in the few steps that the network was trained for
          </label>
          {!automatic && (
            <>
              <label class="field">
                <span>guidance {now.guidance ?? GUIDANCE}</span>
                <input type="range" min={0} max={10} step={0.5} value={now.guidance ?? GUIDANCE} onInput={(event) => change("guidance", { guidance: Number(event.currentTarget.value) })} />
              </label>
              <label class="field">
                <span>steps {now.steps ?? STEPS}</span>
                <input type="range" min={2} max={50} step={1} value={now.steps ?? STEPS} onInput={(event) => change("steps", { steps: Number(event.currentTarget.value) })} />
              </label>
            </>
          )}
        </div>
      </details>
      {take.value?.state === "done" && take.value.how === "animate" && (
        <p class="hint">
          <button
            class="link"
            onClick={() => {
              const one = take.value;
              if (one) {
                const link = replayLink(one);
                navigator.clipboard?.writeText(link).then(
                  () => say("the link is copied: it makes this take again from its sentence and seed"),
                  () => say(link),
                );
              }
            }}
          >
            copy a link that replays it
          </button>
        </p>
      )}
    </section>
  );
}

function Jobs() {
  const old = interrupted.value;
  return (
    <>
      {uploading.value && (
        <p role="status">
          {uploading.value.name} <progress max={1} value={uploading.value.done} />
        </p>
      )}
      {old.map((job) => (
        <p key={job.id} class="hint">
          {job.title}: interrupted.{" "}
          <button
            class="link"
            onClick={() =>
              void attempt(async () => {
                const made = await send<{ id: string }>("POST", `/jobs/${job.id}/again`);
                await ended(made.id);
              })
            }
          >
            again
          </button>{" "}
          <button class="link" onClick={() => void attempt(() => send("DELETE", `/jobs/${job.id}`))}>
            forget
          </button>
        </p>
      ))}
    </>
  );
}

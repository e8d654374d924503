// What stands beside the view: characters with what was guessed of them, takes, and how they are made.

import { useRef } from "preact/hooks";
import { choose, deleteCharacter, deleteTake, dress, repair, openAsMotion, replayLink, sample, select, star } from "./actions";
import { send } from "./api";
import { openAll } from "./drop";
import { changing } from "./prompt";
import {
  about, attempt, change, character, characters, colouring, comparing, doc, ended, interrupted, ownTakes, running, say,
  take, uploading, weightOf,
} from "./state";
import type { Apparel as ApparelWay, Character, Take } from "./types";

const UNITS: Record<string, string> = { m: "metres", cm: "centimetres", mm: "millimetres", in: "inches" };
const HANDLES =
  "pelvis,left hip,right hip,spine 1,left knee,right knee,spine 2,left ankle,right ankle,spine 3,left foot,right foot,neck,left collar,right collar,head,left shoulder,right shoulder,left elbow,right elbow,left wrist,right wrist,left fingers,right fingers,head top,face,left wing,right wing,tail,tail tip".split(
    ",",
  );
const KEPT = ["legs", "arms", "left arm", "right arm", "torso", "head", "upper body", "lower body", "tail", "wings", "root"];

function axis(name: string): string {
  return name.toUpperCase().replace("-", "−");
}

/** What was guessed, each with what repairs it. */
function Chips({ one }: { one: Character }) {
  const chips: preact.ComponentChildren[] = [];
  const { axes, unit, settings } = one;
  const free = running.value.length === 0;
  if (axes?.other && (axes.sure < 0.97 || settings.up !== "auto")) {
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

function Fit({ one }: { one: Character }) {
  const free = running.value.length === 0;
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

/** How hair and clothes move, and the dial of learned ones. */
function Apparel({ one }: { one: Character }) {
  const now = doc.value;
  const shown = take.value?.state === "done" ? take.value : null;
  const ways: [ApparelWay, string, boolean][] = [
    ["rigid", "move with the body", true],
    ["simulate", "simulated by the file's physics", Boolean(one.physics)],
    ["learn", "learned from cloth", Boolean(one.apparel)],
  ];
  return (
    <>
      <label class="field">
        <span>hair and clothes</span>
        <select id="apparel" value={now.apparel} onChange={(event) => change("", { apparel: event.currentTarget.value as ApparelWay })}>
          {ways.map(
            ([way, text, there]) =>
              there && (
                <option key={way} value={way}>
                  {text}
                </option>
              ),
          )}
        </select>
      </label>
      {now.apparel === "learn" && (
        <label class="field">
          <span>stiffness ×{factor(now.stiffness)}</span>
          <input
            id="stiffness"
            type="range"
            min={-2}
            max={2}
            step={0.1}
            value={Math.log10(now.stiffness)}
            aria-valuetext={`${factor(now.stiffness)} times as stiff`}
            onInput={(event) => change("stiffness", { stiffness: Number((10 ** Number(event.currentTarget.value)).toPrecision(3)) })}
            onChange={() => shown?.stiffness && void dress()}
          />
        </label>
      )}
      {shown && (now.apparel === "learn" ? shown.stiffness !== now.stiffness : (shown.asked?.["apparel"] ?? "rigid") !== now.apparel) && (
        <p class="hint">
          <button class="link" id="dress" disabled={running.value.length > 0} onClick={() => void dress()}>
            dress this take so
          </button>
        </p>
      )}
    </>
  );
}

const factor = (stiffness: number): string => String(Number(stiffness.toPrecision(2)));

export function Characters() {
  const files = useRef<HTMLInputElement>(null);
  const motion = useRef<HTMLInputElement>(null);
  const now = character.value;
  return (
    <section class="panel" aria-label="characters">
      <header>
        <h2>Characters</h2>
        <button onClick={() => files.current?.click()}>Open…</button>
        <input
          ref={files}
          type="file"
          multiple
          hidden
          id="open-files"
          onChange={(event) => {
            const found = new Map([...(event.currentTarget.files ?? [])].map((file) => [file.name, file]));
            event.currentTarget.value = "";
            if (found.size) {
              void openAll(found);
            }
          }}
        />
      </header>
      <p class="hint">
        Drop a mesh, a VRM, a PMX (as ZIP or folder), a motion (BVH, VMD, VRMA, AMASS) or a project anywhere.
      </p>
      <ul class="list">
        {characters.value.map((one) => (
          <li key={one.id} class={one.id === doc.value.character ? "chosen" : ""}>
            <button class="name" aria-pressed={one.id === doc.value.character} onClick={() => select(one.id)}>
              {one.name}
              <small>
                {one.state === "ready"
                  ? `${one.vertices?.toLocaleString()} vertices · ${one.height?.toPrecision(3)} m`
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
      {now?.state === "ready" && (
        <>
          <Chips one={now} />
          <Fit one={now} />
          <div class="fields">
            <label class="field">
              <span>show</span>
              <select
                id="colouring"
                value={colouring.value}
                onChange={(event) => (colouring.value = event.currentTarget.value as "none" | "handles" | "weights")}
              >
                <option value="none">as it is</option>
                <option value="handles">handles in colour</option>
                <option value="weights">weights of one handle</option>
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
          {(now.physics || now.apparel) && <Apparel one={now} />}
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
        </>
      )}
      <h3>Samples</h3>
      <div class="chips">
        {about.value?.samples.map((name) => (
          <button key={name} class="chip" onClick={() => void sample(name)}>
            {name}
          </button>
        ))}
      </div>
    </section>
  );
}

const titleOf = (one: Take): string =>
  one.title ||
  (one.how === "edit"
    ? `${String(one.asked?.["prompt"] ?? "changed")}`
    : one.how === "dress"
      ? `dressed · ${one.script[0]?.text ?? ""}`
    : one.how === "bend"
      ? `pinned · ${one.script[0]?.text ?? ""}`
      : one.script.map((part) => part.text).join("; "));

function Row({ one }: { one: Take }) {
  const chosen = one.id === doc.value.take;
  const job = running.value.find((each) => each.about.takes?.includes(one.id));
  return (
    <li class={chosen ? "chosen" : ""}>
      <button class="icon" aria-label={one.star ? "remove the star" : "star"} aria-pressed={one.star} onClick={() => void star(one)}>
        {one.star ? "★" : "☆"}
      </button>
      <button class="name" aria-pressed={chosen} onClick={() => choose(one.id)}>
        {titleOf(one)}
        <small>
          {one.state === "done"
            ? `${one.how === "transfer" ? "transfer" : `seed ${one.seed}`} · ${one.seconds?.toFixed(1)} s${one.stiffness ? ` · stiffness ×${factor(one.stiffness)}` : ""}`
            : one.error || (job ? `${job.stage || one.state} ${Math.round(job.done * 100)} %` : one.state)}
        </small>
        {job && <progress max={1} value={job.done} />}
      </button>
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

export function Takes() {
  const now = doc.value;
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
        <details open={changing.value}>
          <summary>change this take</summary>
          <p class="hint">Keep parts of the body, select a span below, or pin poses; the rest is generated anew.</p>
          <div class="chips">
            {KEPT.map((part) => (
              <button
                key={part}
                class="chip"
                aria-pressed={now.keep.includes(part)}
                onClick={() => {
                  changing.value = true;
                  change("", { keep: now.keep.includes(part) ? now.keep.filter((each) => each !== part) : [...now.keep, part] });
                }}
              >
                keep {part}
              </button>
            ))}
          </div>
          <p class="hint">Pause, then drag the blue dots at hands and feet: a pin at that time.</p>
        </details>
      )}
      <details>
        <summary>how takes are drawn</summary>
        <div class="fields">
          <label class="field">
            <span>guidance {now.guidance}</span>
            <input type="range" min={0} max={10} step={0.5} value={now.guidance} onInput={(event) => change("guidance", { guidance: Number(event.currentTarget.value) })} />
          </label>
          <label class="field">
            <span>steps {now.steps}</span>
            <input type="range" min={2} max={50} step={1} value={now.steps} onInput={(event) => change("steps", { steps: Number(event.currentTarget.value) })} />
          </label>
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

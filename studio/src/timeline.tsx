// Time: sentences with edges to drag, the span that changes, pinned poses, hands and feet, and where we are.

import { useRef } from "preact/hooks";
import { addClip, bend } from "./actions";
import { clipOf, DRAGGED } from "./library";
import { blocksOf, fromFile, inRange, lasting, readPath } from "./script";
import { seconds as shownSeconds } from "./stage";
import { change, character, doc, drawing, follow, playing, speed, take, time, total, unfolded } from "./state";

const PARTS: Record<string, string> = {
  left_hand: "left hand",
  right_hand: "right hand",
  left_foot: "left foot",
  right_foot: "right foot",
};

/** How long the line is [s]: the sentences, or the take where that is longer. */
const length = (): number =>
  Math.max(fromFile(take.value, doc.value) ? 0 : total.value, take.value?.seconds ?? 0, 0.5);
const SPEEDS: Record<string, string> = { "0.25": "quarter speed", "0.5": "half speed", "1": "normal speed", "2": "double speed" };
const MOST_MARKS = 60;
const percent = (seconds: number): string => `${(100 * seconds) / length()}%`;
const snapped = (seconds: number): number => Math.round(seconds * 20) / 20;

/** The seconds that the ruler names: all, or so many that they fit. */
export function marks(seconds: number): number[] {
  const apart = [1, 2, 5, 10, 30, 60, 300, 600, 3600].find((each) => seconds / each <= MOST_MARKS) ?? seconds / MOST_MARKS;
  return Array.from({ length: Math.floor(seconds / apart) + 1 }, (_, number) => number * apart);
}

export function clock(seconds: number): string {
  const whole = Math.max(seconds, 0);
  return `${Math.floor(whole / 60)}:${(whole % 60).toFixed(2).padStart(5, "0")}`;
}

/** Follow the pointer on a row until it is let go; `moved` hears the time under it. */
function track(event: PointerEvent, row: HTMLElement, moved: (seconds: number) => void): void {
  const box = row.getBoundingClientRect();
  const at = (one: PointerEvent): number =>
    Math.min(Math.max(((one.clientX - box.left) / box.width) * length(), 0), length());
  const target = event.currentTarget as HTMLElement;
  target.setPointerCapture(event.pointerId);
  const move = (one: PointerEvent): void => moved(at(one));
  const up = (): void => {
    target.removeEventListener("pointermove", move);
    target.removeEventListener("pointerup", up);
  };
  target.addEventListener("pointermove", move);
  target.addEventListener("pointerup", up);
  move(event);
}

function Sentences() {
  const row = useRef<HTMLDivElement>(null);
  const { script, sentence } = doc.value;
  return (
    <div
      class="row sentences"
      ref={row}
      onDragOver={(event) => {
        if (event.dataTransfer?.types.includes(DRAGGED)) {
          event.preventDefault();
          event.stopPropagation();
        }
      }}
      onDrop={(event) => {
        const clip = clipOf(event.dataTransfer?.getData(DRAGGED) ?? "");
        if (clip && row.current) {
          event.preventDefault();
          event.stopPropagation();
          const box = row.current.getBoundingClientRect();
          const at = ((event.clientX - box.left) / box.width) * length();
          const next = blocksOf(doc.value, take.value).find((block) => block.number !== null && at < block.from + block.seconds / 2);
          addClip(clip, next?.number ?? undefined);
        }
      }}
    >
      {blocksOf(doc.value, take.value).map(({ text, from, seconds, number, clip }) => {
        if (number === null) {
          return (
            <div key="file" class="block chosen file" style={{ left: percent(from), width: percent(seconds) }}>
              <span class="words">
                {text} <small>{seconds.toFixed(1)} s</small>
              </span>
            </div>
          );
        }
        const part = { text, seconds };
        const set = (length: number): void => {
          const limit = inRange(snapped(length));
          change("length", { script: lasting(doc.value.script, number, limit) });
        };
        return (
          <div
            key={number}
            class={`block ${number === sentence ? "chosen" : ""} ${clip ? "clip" : ""}`}
            style={{ left: percent(from), width: percent(part.seconds) }}
          >
            <button
              class="words"
              aria-pressed={number === sentence}
              onClick={() => {
                change("", { sentence: number }, { changing: false });
                document.getElementById("sentence")?.focus();
              }}
            >
              {clip ? "▶ " : ""}
              {part.text || "…"} <small>{Number(part.seconds.toFixed(2))} s</small>
            </button>
            {script.length > 1 && (
              <button
                class="remove"
                aria-label={`remove: ${part.text}`}
                onClick={() => change("remove a sentence", { script: script.filter((_, place) => place !== number), sentence: 0 })}
              >
                ×
              </button>
            )}
            <div
              class="edge"
              role="slider"
              tabIndex={0}
              aria-label={`seconds of: ${part.text}`}
              aria-valuenow={part.seconds}
              aria-valuemin={0.5}
              aria-valuemax={120}
              onPointerDown={(event) => row.current && track(event, row.current, (at) => set(at - from))}
              onKeyDown={(event) => {
                const step = { ArrowLeft: -0.5, ArrowRight: 0.5 }[event.key];
                if (step) {
                  event.preventDefault();
                  event.stopPropagation();
                  set(part.seconds + step);
                }
              }}
            />
          </div>
        );
      })}
    </div>
  );
}

function Keys({ part }: { part: string }) {
  return (
    <div class="row thin">
      {doc.value.pins
        .filter((pin) => pin.part === part)
        .map((pin) => (
          <button
            key={pin.time}
            class="key"
            style={{ left: percent(pin.time) }}
            title={`${PARTS[part]} pinned at ${pin.time} s; click goes there, Delete removes`}
            aria-label={`${PARTS[part]} pinned at ${pin.time} seconds`}
            onClick={() => (time.value = pin.time)}
            onKeyDown={(event) => {
              if (event.key === "Delete" || event.key === "Backspace") {
                change("unpin", { pins: doc.value.pins.filter((one) => one !== pin) });
                void bend();
              }
            }}
          >
            ◆
          </button>
        ))}
    </div>
  );
}

function Poses() {
  return (
    <div class="row thin">
      {doc.value.poses.map((pose) => (
        <button
          key={pose.time}
          class="key pose"
          style={{ left: percent(pose.time) }}
          title={`the pose at ${pose.time} s stays; click goes there, Delete removes`}
          aria-label={`pose pinned at ${pose.time} seconds`}
          onClick={() => (time.value = pose.time)}
          onKeyDown={(event) => {
            if (event.key === "Delete" || event.key === "Backspace") {
              change("unpin", { poses: doc.value.poses.filter((one) => one !== pose) });
            }
          }}
        >
          ◆
        </button>
      ))}
    </div>
  );
}

function Span() {
  const row = useRef<HTMLDivElement>(null);
  const { span } = doc.value;
  return (
    <div
      class="row thin span-row"
      ref={row}
      title="drag to select what is made anew"
      onPointerDown={(event) => {
        if (!row.current || !take.value) {
          return;
        }
        let first: number | null = null;
        track(event, row.current, (at) => {
          first ??= snapped(at);
          const other = snapped(at);
          if (Math.abs(other - first) >= 0.1) {
            change("select a span", { span: [Math.min(first, other), Math.max(first, other)] }, { changing: true });
          }
        });
      }}
    >
      {!span && <span class="hint">drag here over what is to be made anew</span>}
      {span && (
        <span class="span" style={{ left: percent(span[0]), width: percent(span[1] - span[0]) }}>
          <button
            class="remove"
            aria-label="forget the span"
            onPointerDown={(event) => event.stopPropagation()}
            onClick={() => change("forget the span", { span: null })}
          >
            ×
          </button>
        </span>
      )}
    </div>
  );
}

export function pinPose(): void {
  const one = take.value;
  if (!one || one.state !== "done") {
    return;
  }
  const at = Math.round(time.value * 20) / 20;
  const rest = doc.value.poses.filter((pose) => Math.abs(pose.time - at) > 0.02);
  change("pin a pose", { poses: [...rest, { time: at, take: one.id, at }].sort((a, b) => a.time - b.time) }, { changing: true });
}

export function Timeline() {
  const lane = useRef<HTMLDivElement>(null);
  const now = doc.value;
  const filled = new Set(now.pins.map((pin) => pin.part));
  const ends = (character.value?.ends ?? []).filter((end) => filled.has(end.part));
  const changes = unfolded.value || now.span !== null;
  const posed = now.poses.length > 0;
  const pathed = drawing.value || now.path.length > 1;
  const fps = take.value?.fps ?? 20;
  const step = (frames: number): void => {
    playing.value = false;
    time.value = Math.min(Math.max((Math.round(time.value * fps) + frames) / fps, 0), Math.max(shownSeconds(), 0));
  };
  return (
    <section class="timeline" aria-label="timeline">
      <div class="transport">
        <button class="play" aria-label={playing.value ? "pause" : "play"} title="Space" onClick={() => (playing.value = !playing.value)}>
          <svg viewBox="0 0 16 16" width="16" height="16" aria-hidden="true">
            <path d={playing.value ? "M3 2h4v12H3zM9 2h4v12H9z" : "M4 1.5v13l10-6.5z"} fill="currentColor" />
          </svg>
        </button>
        <output class="clock">
          {clock(time.value)} <span class="muted">of {clock(take.value?.seconds ?? total.value)}</span>
        </output>
        <div class="tools">
          <label class="field small">
            <span class="unseen">speed</span>
            <select value={String(speed.value)} onChange={(event) => (speed.value = Number(event.currentTarget.value))}>
              {Object.entries(SPEEDS).map(([one, name]) => (
                <option key={one} value={one}>
                  {name}
                </option>
              ))}
            </select>
          </label>
          <label class="toggle">
            <input type="checkbox" checked={follow.value} onChange={(event) => (follow.value = event.currentTarget.checked)} /> follow
          </label>
          <label class="toggle">
            <input type="checkbox" checked={now.loop} onChange={(event) => change("", { loop: event.currentTarget.checked, path: event.currentTarget.checked ? [] : now.path })} /> loop
          </label>
          <label class="toggle">
            <input type="checkbox" checked={now.inPlace} onChange={(event) => change("", { inPlace: event.currentTarget.checked, path: event.currentTarget.checked ? [] : now.path })} /> on the spot
          </label>
          <span class="fill" />
          <button onClick={() => change("add a sentence", { script: [...now.script, { text: "waves", seconds: 3 }], sentence: now.script.length })}>
            Add a sentence
          </button>
          <button id="fold" aria-expanded={unfolded.value} onClick={() => (unfolded.value = !unfolded.value)}>
            Direct
          </button>
        </div>
      </div>
      {(unfolded.value || pathed) && (
        <div class="transport directing">
          <button class="icon" aria-label="a frame back" title="←" onClick={() => step(-1)}>
            ‹
          </button>
          <button class="icon" aria-label="a frame on" title="→" onClick={() => step(1)}>
            ›
          </button>
          <span class="muted">frame {Math.round(time.value * fps)}</span>
          <button onClick={pinPose} disabled={take.value?.state !== "done"} title="I: this pose stays, the rest is made anew">
            Pin this pose
          </button>
          <button
            id="draw"
            aria-pressed={drawing.value}
            onClick={() => {
              drawing.value = !drawing.value;
              if (drawing.value) {
                change("", { loop: false, inPlace: false });
              }
            }}
            title="P: drag on the floor where the character goes"
          >
            Draw a path
          </button>
          {pathed && (
            <label class="field small">
              <span>points of the path</span>
              <input
                id="path"
                value={now.path.map((point) => point.join(",")).join(" ")}
                placeholder="0,0 1,2 3,2"
                aria-label="points of the path: x and z in metres, as 0,0 1,2 3,2"
                onChange={(event) => {
                  const path = readPath(event.currentTarget.value);
                  change("type a path", { path, loop: false, inPlace: false });
                  drawing.value = false;
                }}
              />
            </label>
          )}
          {now.path.length > 1 && <button onClick={() => change("forget the path", { path: [] })}>Forget the path</button>}
        </div>
      )}
      <div class={`lanes ${changes || posed || ends.length ? "named" : ""}`}>
        <div class="names" aria-hidden="true">
          <span>sentences</span>
          {changes && <span class="thin">made anew</span>}
          {posed && <span class="thin">poses</span>}
          {ends.map((end) => (
            <span class="thin" key={end.part}>
              {PARTS[end.part] ?? end.part}
            </span>
          ))}
        </div>
        <div class="lane" ref={lane}>
          <Sentences />
          {changes && <Span />}
          {posed && <Poses />}
          {ends.map((end) => (
            <Keys key={end.part} part={end.part} />
          ))}
          <div
            class="playhead"
            role="slider"
            tabIndex={0}
            aria-label="time"
            aria-valuemin={0}
            aria-valuemax={length()}
            aria-valuenow={time.value}
            aria-valuetext={clock(time.value)}
            style={{ left: percent(Math.min(time.value, length())) }}
            onPointerDown={(event) => {
              playing.value = false;
              if (lane.current) {
                track(event, lane.current, (at) => (time.value = Math.min(at, Math.max(shownSeconds(), 0))));
              }
            }}
          />
          <div
            class="ruler"
            onPointerDown={(event) => {
              playing.value = false;
              if (lane.current) {
                track(event, lane.current, (at) => (time.value = Math.min(at, Math.max(shownSeconds(), 0))));
              }
            }}
          >
            {marks(length()).map((second) => (
              <span key={second} class={second > 0.97 * length() ? "last" : ""} style={{ left: percent(second) }}>
                {second}
              </span>
            ))}
          </div>
        </div>
      </div>
    </section>
  );
}

// How hair and clothes move, what of a character they are, and the chains that they swing on.

import { dress } from "./actions";
import { asFound, endPainting, lift, startPainting, touch, worn } from "./painting";
import { viewer } from "./stage";
import { brush, change, comparing, doc, painting, playing, running, take } from "./state";
import type { Apparel as ApparelWay, Character } from "./types";

const factor = (value: number): string => String(Number(value.toPrecision(2)));

/** How hair and clothes move, and the dials of those that move on their own. */
export function Apparel({ one }: { one: Character }) {
  const now = doc.value;
  const shown = take.value?.state === "done" ? take.value : null;
  const chained = Boolean(one.chains?.length);
  const ways: [ApparelWay, string, boolean][] = [
    ["rigid", "move with the body", true],
    ["simulate", "simulated by the file's physics", Boolean(one.physics)],
    ["chains", "swing on chains of bones", chained],
    ["learn", "learned from cloth", Boolean(one.apparel)],
  ];
  const dressed = shown?.stiffness != null && (now.apparel === "learn" || now.apparel === "chains");
  const other =
    now.apparel === "learn" || now.apparel === "chains"
      ? (shown?.worn ?? (shown?.stiffness ? "learn" : null)) !== now.apparel || shown?.stiffness !== now.stiffness ||
        (now.apparel === "chains" && shown?.gravity !== now.gravity)
      : (shown?.asked?.["apparel"] ?? "rigid") !== now.apparel;
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
      {(now.apparel === "learn" || now.apparel === "chains" || now.live) && (
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
            onChange={() => dressed && void dress()}
          />
        </label>
      )}
      {(now.apparel === "chains" || now.live) && (
        <label class="field">
          <span>gravity ×{factor(now.gravity)}</span>
          <input
            id="gravity"
            type="range"
            min={0}
            max={4}
            step={0.1}
            value={now.gravity}
            aria-valuetext={`${factor(now.gravity)} times the gravity`}
            onInput={(event) => change("gravity", { gravity: Number(event.currentTarget.value) })}
            onChange={() => dressed && now.apparel === "chains" && void dress()}
          />
        </label>
      )}
      {chained && !comparing.value && (
        <p class="chips">
          <label class="toggle">
            <input id="live" type="checkbox" checked={now.live} onChange={(event) => change("", { live: event.currentTarget.checked })} />
            live springs
          </label>
          {now.live && (
            <button id="shake" title="K; or drag the character" onClick={() => viewer?.shake()}>
              shake it
            </button>
          )}
        </p>
      )}
      {shown && other && (
        <p class="hint">
          <button class="link" id="dress" disabled={running.value.length > 0} onClick={() => void dress()}>
            dress this take so
          </button>
        </p>
      )}
      {one.unchained && !painting.value && <p class="hint">{one.unchained}</p>}
      <Mask one={one} />
    </>
  );
}

/** What of the mesh is hair and clothes, painted with a brush. */
function Mask({ one }: { one: Character }) {
  if (!painting.value) {
    return (
      <p class="hint">
        <button
          class="link"
          id="paint"
          disabled={one.state !== "ready" || one.laid === undefined}
          onClick={() => {
            playing.value = false;
            comparing.value = false;
            void startPainting();
          }}
        >
          paint what is hair and clothes
        </button>
      </p>
    );
  }
  const { add, size } = brush.value;
  const mask = worn.value?.worn.mask ?? new Uint8Array();
  const share = Math.round((100 * mask.reduce((sum, each) => sum + each, 0)) / Math.max(mask.length, 1));
  return (
    <fieldset class="fronts painting">
      <legend>Hair and clothes: {share} %</legend>
      <label class="field">
        <span>brush</span>
        <select id="brush" value={add ? "add" : "remove"} onChange={(event) => (brush.value = { size, add: event.currentTarget.value === "add" })}>
          <option value="add">adds</option>
          <option value="remove">removes</option>
        </select>
      </label>
      <label class="field">
        <span>size {Math.round(size * 100)} %</span>
        <input
          id="brush-size"
          type="range"
          min={0.01}
          max={0.2}
          step={0.005}
          value={size}
          aria-valuetext={`${Math.round(size * 100)} percent of the height`}
          onInput={(event) => (brush.value = { add, size: Number(event.currentTarget.value) })}
        />
      </label>
      <button id="dab" title="X" onClick={dab}>
        {add ? "add" : "remove"} in the middle
      </button>
      <button id="as-found" disabled={!one.painted} onClick={() => void asFound()}>
        as it is found
      </button>
      <button id="painted" class="main" onClick={endPainting}>
        done
      </button>
    </fieldset>
  );
}

/** Touch what is in the middle of the view: painting without a pointer. */
export function dab(): void {
  const view = viewer;
  const model = view?.panes[0]?.model;
  if (painting.value && view && model && touch(model, view.middle(), view.extent)) {
    void lift();
  }
}

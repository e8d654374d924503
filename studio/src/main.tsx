// The page of the studio.

import { effect, signal } from "@preact/signals";
import { render } from "preact";
import { useEffect } from "preact/hooks";
import { choose, replay, star } from "./actions";
import { dab } from "./apparel";
import { hashOf, send, setToken } from "./api";
import { Boundary } from "./boundary";
import { dropped } from "./drop";
import { Header, Help, help, theme } from "./header";
import { Export, exporting } from "./export";
import { DRAGGED, Library } from "./library";
import { Modal } from "./modal";
import { Characters } from "./characters";
import { endCorrecting } from "./correct";
import { picked } from "./parts";
import { begin, living } from "./live";
import { LiveBar, liveKey } from "./lively";
import { endPainting } from "./painting";
import { Prompt } from "./prompt";
import { readReplay, type Replay } from "./schema";
import { Stage, viewer } from "./stage";
import {
  about, aside, attempt, character, comparing, correcting, doc, drawing, follow, locked, notice, ownTakes, painting, playing, redo, sheet, side,
  start, take, time, trouble, undo, warm,
} from "./state";
import { Takes } from "./takes";
import { pinPose, Timeline } from "./timeline";
import "./style.css";

function keys(event: KeyboardEvent): void {
  if (exporting.value || help.value || asking.value) {
    return; // the dialog has the keys
  }
  const target = event.target as HTMLElement;
  if (living.value) {
    if (!liveKey(event, true) && event.key === "Escape") {
      target.blur();
    }
    return; // the character has the keys
  }
  const typing = target.matches("input:not([type=checkbox]):not([type=range]), textarea, select");
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && !typing) {
    event.preventDefault();
    void (event.shiftKey ? redo() : undo());
    return;
  }
  if (typing || event.ctrlKey || event.metaKey || event.altKey) {
    if (event.key === "Escape") {
      target.blur();
    }
    return;
  }
  const number = Number(event.key);
  const fps = take.value?.fps ?? 20;
  const actions: Record<string, () => void> = {
    " ": () => (playing.value = !playing.value),
    ArrowLeft: () => ((playing.value = false), (time.value = Math.max(0, (Math.round(time.value * fps) - 1) / fps))),
    ArrowRight: () => ((playing.value = false), (time.value = Math.min(take.value?.seconds ?? 0, (Math.round(time.value * fps) + 1) / fps))),
    "/": () => document.getElementById("sentence")?.focus(),
    c: () => (comparing.value = !comparing.value && ownTakes.value.length > 1),
    i: pinPose,
    p: () => (drawing.value = !drawing.value),
    f: () => (follow.value = !follow.value),
    k: () => doc.value.live && viewer?.shake(),
    s: () => void (take.value && star(take.value)),
    "+": () => viewer?.turn(0, 0, 1.15),
    "-": () => viewer?.turn(0, 0, 1 / 1.15),
    "?": () => (help.value = true),
    Escape: () => ((drawing.value = false), (notice.value = null), (sheet.value = "")),
  };
  if (correcting.value) {
    actions["Escape"] = () => (picked.value ? (picked.value = null) : void endCorrecting());
  }
  if (painting.value) {
    Object.assign(actions, { x: dab, Escape: endPainting });
  }
  const turns: Record<string, () => void> = {
    ArrowLeft: () => viewer?.turn(-0.15, 0),
    ArrowRight: () => viewer?.turn(0.15, 0),
    ArrowUp: () => viewer?.turn(0, 0.15),
    ArrowDown: () => viewer?.turn(0, -0.15),
  };
  const action = (event.shiftKey && turns[event.key]) || actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (event.key === " " && target.matches("button, summary, input, [role=slider]")) {
    return; // it presses what has the focus
  }
  if (event.key.startsWith("Arrow") && target.matches("input[type=range]")) {
    return; // it moves the slider
  }
  if (action) {
    event.preventDefault();
    action();
  } else if (number >= 1 && number <= 4) {
    const one = ownTakes.value[number - 1];
    if (one) {
      choose(one.id);
    }
  }
}

function Lock() {
  return (
    <form
      class="lock"
      onSubmit={(event) => {
        event.preventDefault();
        const password = new FormData(event.currentTarget).get("password");
        void attempt(async () => {
          setToken((await send<{ token: string }>("POST", "/login", { password })).token);
          location.reload();
        });
      }}
    >
      <h1>Bunraku studio</h1>
      <p>
        Open the address that <code>bunraku studio</code> printed: it holds a token that changes with every start. On
        another machine, type the password.
      </p>
      <input name="password" type="password" autocomplete="current-password" aria-label="password" />
      <button class="main">Open</button>
      <p class="bad" role="alert">
        {notice.value?.text}
      </p>
    </form>
  );
}

function Notice() {
  const said = notice.value;
  return said ? (
    <div class={`notice ${said.bad ? "bad" : ""}`} role={said.bad ? "alert" : "status"}>
      <span>{said.text}</span>
      <button class="icon" aria-label="dismiss" onClick={() => (notice.value = null)}>
        ×
      </button>
    </div>
  ) : null;
}

/** What the studio cannot do at the moment, and what it could not read. */
function Warnings() {
  const all = [...(trouble.value ? [trouble.value] : []), ...aside.value];
  return all.length ? (
    <div class="warnings" role="status">
      {all.map((text) => (
        <p key={text}>{text}</p>
      ))}
      {aside.value.length > 0 && (
        <button class="link" onClick={() => (aside.value = [])}>
          understood
        </button>
      )}
    </div>
  ) : null;
}

const asking = signal<Replay | null>(null);

/** What a link wants to be made: nothing of it happens before it is agreed to. */
function Asking() {
  const link = asking.value;
  return link ? (
    <Modal label="a link" close={() => (asking.value = null)}>
      <h2>A link asks for a take</h2>
      <p>
        Of {link.character || "the character that is shown"}: {link.script.map((part) => `${part.text} (${part.seconds} s)`).join("; ")}
      </p>
      <button class="main" id="replay" onClick={() => void replay(link)}>
        Make it
      </button>{" "}
      <button>Leave it</button>
    </Modal>
  ) : null;
}

/** What the dots in the view are. */
function Legend() {
  const busy = comparing.value || painting.value || living.value || correcting.value;
  const shown = !busy && !playing.value && take.value?.state === "done" && take.value.skin === "handles";
  return shown && (character.value?.ends?.length ?? 0) > 0 ? (
    <p class="legend">
      <i class="dot" /> drag a hand or a foot <i class="dot pinned" /> pinned now
    </p>
  ) : null;
}

const SHEETS = { characters: "Characters", clips: "Clips", takes: "Takes", time: "Timeline" };

/** On a phone, what lies over the stage one at a time. */
function Sheets() {
  return (
    <nav class="sheets" aria-label="sheets">
      {(Object.keys(SHEETS) as (keyof typeof SHEETS)[]).map((one) => (
        <button
          key={one}
          id={`sheet-${one}`}
          aria-expanded={sheet.value === one}
          onClick={() => {
            sheet.value = sheet.value === one ? "" : one;
            if (one === "characters" || one === "clips") {
              side.value = one;
            }
          }}
        >
          {SHEETS[one]}
        </button>
      ))}
      <button id="sheet-live" disabled={character.value?.state !== "ready"} onClick={() => character.value && begin(character.value)}>
        Live
      </button>
    </nav>
  );
}

/** Characters, or the clip library. */
function Sides() {
  const tabs = ["characters", "clips"] as const;
  return (
    <>
      <div class="tabs" role="tablist" aria-label="characters and clips">
        {tabs.map((one) => (
          <button
            key={one}
            id={`tab-${one}`}
            role="tab"
            aria-selected={side.value === one}
            aria-controls="side"
            tabIndex={side.value === one ? 0 : -1}
            onClick={() => (side.value = one)}
            onKeyDown={(event) => {
              if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
                event.stopPropagation();
                side.value = one === "clips" ? "characters" : "clips";
                document.getElementById(`tab-${side.value}`)?.focus();
              }
            }}
          >
            {one === "clips" ? "Clips" : "Characters"}
          </button>
        ))}
      </div>
      <div id="side" class={side.value} role="tabpanel" aria-labelledby={`tab-${side.value}`}>
        <Boundary name={side.value}>{side.value === "clips" ? <Library /> : <Characters />}</Boundary>
      </div>
    </>
  );
}

function App() {
  useEffect(() => {
    const over = (event: DragEvent): void => {
      event.preventDefault();
      if (!event.dataTransfer?.types.includes(DRAGGED)) {
        document.body.classList.add("dropping");
      }
    };
    const out = (event: DragEvent): void => {
      if (!event.relatedTarget) {
        document.body.classList.remove("dropping");
      }
    };
    const drop = (event: DragEvent): void => {
      event.preventDefault();
      document.body.classList.remove("dropping");
      if (event.dataTransfer && !event.dataTransfer.types.includes(DRAGGED)) {
        void attempt(() => dropped(event.dataTransfer as DataTransfer));
      }
    };
    addEventListener("dragover", over);
    addEventListener("dragleave", out);
    addEventListener("drop", drop);
    addEventListener("keydown", keys);
    return () => {
      removeEventListener("dragover", over);
      removeEventListener("dragleave", out);
      removeEventListener("drop", drop);
      removeEventListener("keydown", keys);
    };
  }, []);
  if (locked.value) {
    return <Lock />;
  }
  return (
    <>
      <div>
        <Boundary name="the header">
          <Header />
        </Boundary>
        <Warnings />
      </div>
      <section class="say" aria-label="the sentence">
        <Boundary name="the sentence">
          {living.value ? <LiveBar /> : <Prompt />}
        </Boundary>
      </section>
      <main>
        <aside class="left" aria-label="characters and clips">
          <Sides />
        </aside>
        <Boundary name="the view">
          <Stage>
            {!character.value && about.value && (
              <p class="empty">
                <b>Who takes the stage?</b>
                Drop a character here, or choose a sample.
              </p>
            )}
            {character.value?.state === "opening" && !correcting.value && <p class="badge" role="status">finding the handles of {character.value.name}…{warm.value ? "" : " the networks are being loaded, once"}</p>}
            {correcting.value && <p class="badge">drag a joint to where it belongs; click a part to say what it is; drag beside the character to turn it</p>}
            {painting.value && <p class="badge">drag over hair and clothes; drag beside the character to turn it</p>}
            {drawing.value && <p class="badge">drag on the floor where it goes, or type its points below; the sentence says how</p>}
            <Legend />
            <Notice />
          </Stage>
        </Boundary>
        <aside class="right" aria-label="takes of the character">
          <Boundary name="takes">
            <Takes />
          </Boundary>
        </aside>
      </main>
      <footer>
        <Boundary name="the timeline">
          <Timeline />
        </Boundary>
        <Sheets />
      </footer>
      <Export />
      <Asking />
      <Help />
      <div class="veil" aria-hidden="true">
        drop it anywhere
      </div>
    </>
  );
}

const root = document.getElementById("app");
if (root) {
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
    playing.value = false;
  }
  const wanted = hashOf(location.hash).get("replay");
  history.replaceState(null, "", location.pathname);
  root.replaceChildren(); // the page's bones, which stood there until now
  root.className = "";
  root.removeAttribute("aria-busy");
  render(<App />, root);
  effect(() => {
    root.dataset["sheet"] = sheet.value;
    root.dataset["several"] = String(comparing.value);
    root.dataset["live"] = String(Boolean(living.value));
  });
  effect(() => {
    document.documentElement.dataset["theme"] = theme.value;
    viewer?.theme(theme.value === "dark");
  });
  void attempt(async () => {
    await start();
    viewer?.theme(theme.value === "dark");
    if (wanted) {
      asking.value = readReplay(wanted);
    }
  });
  if (import.meta.env.MODE === "checked") {
    void import("./checks"); // tests look into the page; what is shipped holds nothing of it
  }
}

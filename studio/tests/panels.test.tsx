import { render } from "preact";
import { act } from "preact/test-utils";
import { beforeEach, expect, test, vi } from "vitest";
import { Boundary } from "../src/boundary";
import { Menu } from "../src/menu";

let root: HTMLElement;
beforeEach(() => {
  document.body.innerHTML = '<div id="root"></div><p id="elsewhere"></p>';
  root = document.getElementById("root") as HTMLElement;
});
const shown = (): boolean => root.querySelector("[role=menu]") !== null;
const press = (key: string): Promise<void> =>
  act(() => void document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true })));

async function opened(): Promise<void> {
  await act(() =>
    render(
      <Menu id="export" label="Export" disabled={false}>
        <button role="menuitem">GLB</button>
      </Menu>,
      root,
    ),
  );
  await act(() => document.getElementById("export")?.click());
  expect(shown()).toBe(true);
}

test("a menu closes on Escape, and the button has the focus again", async () => {
  await opened();
  await press("a");
  expect(shown()).toBe(true);
  await press("Escape");
  expect(shown()).toBe(false);
  expect(document.activeElement?.id).toBe("export");
});

test("a menu closes on a click outside of it and on a choice, and not on one inside", async () => {
  await opened();
  const down = (target: Element | null): Promise<void> =>
    act(() => void target?.dispatchEvent(new Event("pointerdown", { bubbles: true })));
  await down(root.querySelector("[role=menuitem]"));
  expect(shown()).toBe(true);
  await down(document.getElementById("elsewhere"));
  expect(shown()).toBe(false);
  await opened();
  await act(() => (root.querySelector("[role=menuitem]") as HTMLElement).click());
  expect(shown()).toBe(false);
});

test("what throws in a panel stays in it, and it can be shown again", async () => {
  vi.spyOn(console, "warn").mockImplementation(() => undefined);
  let broken = true;
  const Panel = () => {
    if (broken) {
      throw new Error("script.map is not a function");
    }
    return <p>works</p>;
  };
  await act(() =>
    render(
      <>
        <Boundary name="takes">
          <Panel />
        </Boundary>
        <p>beside it</p>
      </>,
      root,
    ),
  );
  expect(root.textContent).toContain("The panel of takes stopped (script.map is not a function)");
  expect(root.textContent).toContain("beside it");
  broken = false;
  await act(() => (root.querySelector("button") as HTMLElement).click());
  expect(root.textContent).toBe("worksbeside it");
});

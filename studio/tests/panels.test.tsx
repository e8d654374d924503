import { render } from "preact";
import { act } from "preact/test-utils";
import { beforeEach, expect, test, vi } from "vitest";
import { Boundary } from "../src/boundary";
import { across } from "../src/characters";
import { skeletonOf } from "../src/skeleton";
import type { Character } from "../src/types";

let root: HTMLElement;
beforeEach(() => {
  document.body.innerHTML = '<div id="root"></div>';
  root = document.getElementById("root") as HTMLElement;
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

test("the left side of a character lies across its up and its front", () => {
  expect(across("+y", "+z")).toBe("+x");
  expect(across("+z", "-y")).toBe("+x");
  expect(across("+y", "-z")).toBe("-x");
  expect(across("+y", "+x")).toBe("-z");
  expect(across("-z", "+x")).toBe("-y");
});

test("bones are drawn to the next part towards the root that a handle plays", () => {
  const one = { roles: [0, 1, 4, 20, 7], used: [0, 1, 2, 3] } as unknown as Character;
  expect(skeletonOf(one, "handles", [])).toEqual([
    [0, 1],
    [1, 2],
    [0, 3],
  ]);
});

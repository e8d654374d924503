import { expect, test } from "vitest";
import { listen } from "../src/api";

test("changes are heard in order, each once, and all is fetched anew where something was missed", async () => {
  const asked: string[] = [];
  const answers: [number, unknown][] = [
    [200, { event: 4, missed: false, changes: [["take", { id: "a" }], ["job", { id: "b" }]] }],
    [500, { error: "no" }],
    [200, { event: 4, missed: false, changes: [] }],
    [200, { event: 99, missed: true, changes: [] }],
    [200, { event: 121, missed: false, changes: [["take", { id: "c" }]] }],
    [401, { error: "another run" }],
  ];
  globalThis.fetch = (async (path: string) => {
    asked.push(path);
    const [status, body] = answers.shift() ?? [401, {}];
    return new Response(JSON.stringify(body), { status });
  }) as unknown as typeof fetch;
  const heard: unknown[] = [];
  const up: boolean[] = [];
  await listen(3, {
    heard: (what, data) => heard.push([what, data]),
    missed: async () => 120,
    open: (now) => up.push(now),
    busy: () => true,
  });
  expect(heard).toEqual([["take", { id: "a" }], ["job", { id: "b" }], ["take", { id: "c" }]]);
  expect(asked.map((path) => Number(path.split("=")[1]))).toEqual([3, 4, 4, 4, 120, 121]);
  expect(up).toEqual([true, false, true, true, true, false]);
});

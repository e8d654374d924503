// Talking to the studio's server: the token, requests, uploads with progress, and asking what has changed.

const KEY = "bunraku-token";

export class ServerError extends Error {
  constructor(
    message: string,
    readonly status: number,
  ) {
    super(message);
  }
}

/** What stands behind the address's hash: token and replay. */
export function hashOf(address: string): URLSearchParams {
  return new URLSearchParams(address.replace(/^#/, ""));
}

const given = hashOf(location.hash).get("token");
if (given && !localStorage.getItem(KEY)) {
  localStorage.setItem(KEY, given);
}

/** Take the token of the address in place of the one that is kept, if the studio does: a link alone locks nobody out. */
export async function enter(): Promise<void> {
  if (given && given !== token()) {
    const answer = await fetch("api/changes", { headers: { authorization: `Bearer ${given}` } }).catch(() => null);
    if (answer?.ok) {
      setToken(given);
    }
  }
}

export function token(): string {
  return localStorage.getItem(KEY) ?? "";
}

export function setToken(value: string): void {
  localStorage.setItem(KEY, value);
}

async function answerOf(response: Response): Promise<Response> {
  if (response.ok) {
    return response;
  }
  let sentence = `the server answered ${response.status}; is the studio still running?`;
  try {
    const body = (await response.json()) as { error?: string };
    sentence = body.error ?? sentence;
  } catch {
    // not one of ours
  }
  throw new ServerError(sentence, response.status);
}

export async function request(path: string, options: RequestInit = {}): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(`api${path}`, {
      ...options,
      headers: { ...(options.headers as Record<string, string> | undefined), authorization: `Bearer ${token()}` },
    });
  } catch {
    throw new ServerError("the studio does not answer; start it again with: bunraku studio", 0);
  }
  return answerOf(response);
}

export async function get<T>(path: string): Promise<T> {
  return (await request(path)).json() as Promise<T>;
}

export async function send<T>(method: string, path: string, body?: unknown): Promise<T> {
  const options: RequestInit = { method };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
  }
  const answer = (await (await request(path, options)).json()) as T;
  poke();
  return answer;
}

export async function bytes(path: string, options: RequestInit = {}): Promise<ArrayBuffer> {
  return (await request(path, options)).arrayBuffer();
}

/** Send a file as it is; `told` hears the share that is there. */
export function upload<T>(path: string, file: Blob, told: (done: number) => void): Promise<T> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `api${path}`);
    request.setRequestHeader("authorization", `Bearer ${token()}`);
    request.upload.onprogress = (event) => told(event.lengthComputable ? event.loaded / event.total : 0);
    request.onerror = () => reject(new ServerError("the file did not reach the studio; drop it again", 0));
    request.onload = () => {
      try {
        const body = JSON.parse(request.responseText) as T & { error?: string };
        if (request.status < 300) {
          resolve(body);
          poke();
        } else {
          reject(new ServerError(body.error ?? `the server answered ${request.status}`, request.status));
        }
      } catch {
        reject(new ServerError(`the server answered ${request.status}`, request.status));
      }
    };
    request.send(file);
  });
}

interface Changes {
  event: number;
  missed: boolean;
  changes: [string, unknown][];
}

const BUSY = 150; // milliseconds between two questions while something is being made
const IDLE = 1500;
const HIDDEN = 5000;

let poke = (): void => undefined;

/** Something was changed: ask at once what has. */
export const poked = (): void => poke();

function pause(length: number): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, length);
    poke = () => {
      clearTimeout(timer);
      resolve();
    };
  });
}

export interface Listener {
  heard: (what: string, data: unknown) => void;
  /** More has happened than is remembered: all is to be fetched anew, and the number comes back from which on it is known. */
  missed: () => Promise<number>;
  open: (up: boolean) => void;
  busy: () => boolean;
}

/** Ask what has changed after number `after`, for good. A question holds no line, so any number of tabs get their answers. */
export async function listen(after: number, one: Listener): Promise<void> {
  let last = after;
  for (;;) {
    try {
      const found = await get<Changes>(`/changes?after=${last}`);
      last = found.missed ? await one.missed() : found.event;
      for (const [what, data] of found.changes) {
        one.heard(what, data);
      }
      one.open(true);
    } catch (error) {
      one.open(false);
      if (error instanceof ServerError && error.status === 401) {
        return;
      }
    }
    await pause(document.hidden ? HIDDEN : one.busy() ? BUSY : IDLE);
  }
}

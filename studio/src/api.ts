// Talking to the studio's server: the token, requests, uploads with progress, and what happens as it happens.

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
if (given) {
  localStorage.setItem(KEY, given);
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

async function asked(path: string, options: RequestInit = {}): Promise<Response> {
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
  return (await asked(path)).json() as Promise<T>;
}

export async function send<T>(method: string, path: string, body?: unknown): Promise<T> {
  const options: RequestInit = { method };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
  }
  return (await asked(path, options)).json() as Promise<T>;
}

export async function bytes(path: string, options: RequestInit = {}): Promise<ArrayBuffer> {
  return (await asked(path, options)).arrayBuffer();
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

/** Listen to server-sent events from number `after` on, for good; `open` says whether the line is up. */
export async function listen(
  after: number,
  heard: (what: string, data: unknown) => void,
  open: (up: boolean) => void,
): Promise<void> {
  let last = after;
  for (;;) {
    try {
      const response = await asked(`/events?after=${last}`);
      const reader = response.body?.pipeThrough(new TextDecoderStream()).getReader();
      if (!reader) {
        return;
      }
      open(true);
      let rest = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) {
          break;
        }
        rest += value;
        const parts = rest.split("\n\n");
        rest = parts.pop() ?? "";
        for (const part of parts) {
          const fields = new Map(
            part.split("\n").map((line) => [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 2)]),
          );
          const data = fields.get("data");
          if (data !== undefined) {
            last = Number(fields.get("id") ?? last);
            heard(fields.get("event") ?? "message", JSON.parse(data));
          }
        }
      }
    } catch (error) {
      if (error instanceof ServerError && error.status === 401) {
        open(false);
        return;
      }
    }
    open(false);
    await new Promise((resolve) => setTimeout(resolve, 1500));
  }
}

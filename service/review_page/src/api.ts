// Talking to the service: the key, where it asks for one, and its problem documents.

const KEY = "boxlift-key";

export class Problem extends Error {
  constructor(
    readonly status: number,
    message: string,
    readonly body: Record<string, unknown>,
  ) {
    super(message);
  }
}

let askForKey: (refused: boolean) => Promise<string> = () => Promise.reject(new Error("no key dialog"));

export function onKeyNeeded(ask: (refused: boolean) => Promise<string>): void {
  askForKey = ask;
}

let asking: Promise<string> | null = null;

/** An answer that is a success. Throws Problem for any other, TypeError where the service cannot be reached. */
export async function request(path: string, init: RequestInit = {}): Promise<Response> {
  for (;;) {
    const key = sessionStorage.getItem(KEY);
    const headers = new Headers(init.headers);
    if (key) headers.set("Authorization", `Bearer ${key}`);
    const response = await fetch(path, { ...init, headers });
    if (response.status === 401) {
      asking ??= askForKey(key !== null).finally(() => (asking = null));
      sessionStorage.setItem(KEY, await asking);
      continue;
    }
    if (response.ok) return response;
    let body: Record<string, unknown> = {};
    try {
      body = (await response.json()) as Record<string, unknown>;
    } catch {
      // no document came along
    }
    throw new Problem(response.status, String(body["detail"] ?? response.statusText), body);
  }
}

export async function getJson<T>(path: string, query: Record<string, string> = {}): Promise<T> {
  const search = new URLSearchParams(query).toString();
  return (await (await request(search ? `${path}?${search}` : path)).json()) as T;
}

export async function postJson<T>(path: string, body: unknown): Promise<T> {
  const init = { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } };
  return (await (await request(path, init)).json()) as T;
}

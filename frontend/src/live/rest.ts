import type {
  AcknowledgeRequest,
  Alarm,
  ArmRequest,
  ControlInfo,
  ControlRequest,
  Priority,
  Problem,
  ProtocolInfo,
  Run,
  RunRequest,
  SafetyReport,
  SessionInfo,
  SignIn,
  StopAnswer,
  StopRequest,
} from "../wire";

const PATIENCE_MS = 5000;
const STOP_PATIENCE_MS = 2000;
const READING_MS = 60_000;
const UNAUTHORIZED = 401;
const SESSION = "/api/session";
const CONTROL = "/api/control";

let tellUnknown = (): void => {};

/** Calls `then` whenever the server does not know who asks. */
export const onUnknown = (then: () => void): void => void (tellUnknown = then);

/** The server said no, in words meant for the person. */
export class Refused extends Error {}

/** Nobody answered. */
export class Unreachable extends Error {}

/** What went wrong, in words. */
export const messageOf = (error: unknown): string => (error instanceof Error ? error.message : String(error));

export const getJson = <Answer>(path: string): Promise<Answer> => ask("GET", path, PATIENCE_MS);

export const postJson = <Answer>(path: string, body?: unknown): Promise<Answer> => ask("POST", path, PATIENCE_MS, body);

export const deletePath = (path: string): Promise<null> => ask("DELETE", path, PATIENCE_MS);

/** Takes as long as the reading of a calibration does. */
export const takeReading = <Answer>(): Promise<Answer> => ask("POST", "/api/calibration/reading", READING_MS);

export const getProtocols = (): Promise<ProtocolInfo[]> => getJson("/api/protocols");

export const startRun = (request: RunRequest): Promise<Run> => postJson("/api/runs", request);

export const arm = (by: string | null): Promise<SafetyReport> => postJson("/api/arm", { by } satisfies ArmRequest);

export const disarm = (by: string | null): Promise<SafetyReport> => postJson("/api/disarm", { by } satisfies ArmRequest);

export const sendStop = (by: string | null): Promise<StopAnswer> => {
  const request: StopRequest = { by };
  return ask("POST", "/api/stop", STOP_PATIENCE_MS, request);
};

export const acknowledgeAlarm = (id: string, priority: Priority, by: string): Promise<Alarm> => {
  const request: AcknowledgeRequest = { by, priority };
  return postJson(`/api/alarms/${encodeURIComponent(id)}/acknowledge`, request);
};

export const getSession = (): Promise<SessionInfo> => getJson(SESSION);

export const signIn = (token: string): Promise<SessionInfo> => {
  const request: SignIn = { token };
  return postJson(SESSION, request);
};

export const signOut = (): Promise<null> => deletePath(SESSION);

export const takeControl = (): Promise<ControlInfo> => {
  const request: ControlRequest = { take_over: true };
  return postJson(CONTROL, request);
};

export const giveControlBack = (): Promise<null> => deletePath(CONTROL);

async function ask<Answer>(method: string, path: string, patienceMs: number, body?: unknown): Promise<Answer> {
  let response: Response;
  try {
    response = await fetch(path, {
      method,
      cache: "no-store",
      signal: AbortSignal.timeout(patienceMs),
      ...(body === undefined ? {} : { body: JSON.stringify(body), headers: { "Content-Type": "application/json" } }),
    });
    if (response.ok) return (response.status === 204 ? null : await response.json()) as Answer;
  } catch (error) {
    const timedOut = error instanceof DOMException && error.name === "TimeoutError";
    throw new Unreachable(timedOut ? `no answer within ${patienceMs / 1000} s` : "the server cannot be reached");
  }
  if (response.status === UNAUTHORIZED && path !== SESSION) tellUnknown();
  throw new Refused(await inWords(response));
}

async function inWords(response: Response): Promise<string> {
  const isProblem = response.headers.get("Content-Type")?.includes("problem+json");
  const problem = isProblem ? ((await response.json().catch(() => null)) as Partial<Problem> | null) : null;
  if (!problem) return `the server answered ${response.status} ${response.statusText}`.trim();
  const detail = problem.detail || problem.title || `error ${response.status}`;
  const fields = (problem.errors ?? [])
    .filter(({ message }) => !message || !detail.includes(message))
    .map((error) => Object.values(error).join(": "));
  return [detail, ...fields].join(" · ");
}

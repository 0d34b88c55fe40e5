import { readServerDate } from "./clock";
import type {
  AcknowledgeRequest,
  Alarm,
  ArmRequest,
  ControlInfo,
  ControlRequest,
  DeclineRequest,
  GraspTruth,
  LabSession,
  LabSessionChange,
  LabSessionRequest,
  Mark,
  MarkRequest,
  Priority,
  Problem,
  ProtocolInfo,
  ReferenceState,
  Run,
  RunRequest,
  SafetyReport,
  SessionInfo,
  SignIn,
  StopAnswer,
  SpotRequest,
  StopRequest,
  ToolInfo,
  TruthCorrection,
  TruthRequest,
  TruthStatement,
} from "../wire";

const TIMEOUT_MS = 5000;
const STOP_TIMEOUT_MS = 2000;
const READING_TIMEOUT_MS = 60_000;
const UPLOAD_TIMEOUT_MS = 120_000;
const UNAUTHORIZED = 401;
const SESSION = "/api/session";
const CONTROL = "/api/control";

let notifySignedOut = (): void => {};

/** Sets the function to call when the server answers that the sign-in is missing or no longer valid. */
export const onSignedOut = (then: () => void): void => void (notifySignedOut = then);

/** The server refused the request. The message is meant for the person. */
export class Refused extends Error {}

/** The server did not answer. */
export class Unreachable extends Error {}

/** Returns the text of an error. */
export const messageOf = (error: unknown): string => (error instanceof Error ? error.message : String(error));

export const getJson = <Answer>(path: string): Promise<Answer> => fetchJson("GET", path, TIMEOUT_MS);

export const postJson = <Answer>(path: string, body?: unknown): Promise<Answer> => fetchJson("POST", path, TIMEOUT_MS, body);

/** Sends a file as it is. */
export const postFile = <Answer>(path: string, file: Blob): Promise<Answer> => fetchJson("POST", path, UPLOAD_TIMEOUT_MS, file);

export const deletePath = (path: string): Promise<null> => fetchJson("DELETE", path, TIMEOUT_MS);

/** Takes one reading of a calibration, which lasts several seconds. */
export const takeReading = <Answer>(): Promise<Answer> => fetchJson("POST", "/api/calibration/reading", READING_TIMEOUT_MS);

/** Makes the tool go on with the constants of another tool file. */
export const useToolFile = (name: string, by: string | null): Promise<ToolInfo> =>
  postJson(`/api/configuration/tool/${encodeURIComponent(name)}/use${by ? `?by=${encodeURIComponent(by)}` : ""}`);

export const getProtocols = (): Promise<ProtocolInfo[]> => getJson("/api/protocols");

/** After an answer, the server's next state says whether the motor moves. */
const STATE_FOLLOWS_MS = 2_000;
let pendingMotions = 0;
let motionAnsweredAt = -Infinity;

/** Whether this page has just asked for something that moves the motor, which the last state need not show yet. */
export const motionWasAsked = (nowMs: number): boolean => pendingMotions > 0 || nowMs - motionAnsweredAt < STATE_FOLLOWS_MS;

async function askForMotion<Answer>(request: Promise<Answer>): Promise<Answer> {
  pendingMotions += 1;
  try {
    return await request;
  } finally {
    pendingMotions -= 1;
    motionAnsweredAt = performance.now();
  }
}

export const startRun = (request: RunRequest): Promise<Run> => askForMotion(postJson("/api/runs", request));

export const arm = (by: string | null, unmeasuredScaleReason: string | null): Promise<SafetyReport> =>
  askForMotion(postJson("/api/arm", { by, unmeasured_scale: unmeasuredScaleReason } satisfies ArmRequest));

export const disarm = (by: string | null): Promise<SafetyReport> => postJson("/api/disarm", { by } satisfies ArmRequest);

export const sendStop = (by: string | null): Promise<StopAnswer> => {
  const request: StopRequest = { by };
  return fetchJson("POST", "/api/stop", STOP_TIMEOUT_MS, request);
};

/** Goes on without a reference grasp today. */
export const declineReference = (by: string | null): Promise<ReferenceState> =>
  postJson("/api/reference/decline", { by } satisfies DeclineRequest);

export const beginSpot = (by: string | null): Promise<Run> => postJson("/api/spots", { by } satisfies SpotRequest);

export const stateTruth = (request: TruthRequest): Promise<TruthStatement> => postJson("/api/truth", request);

export const getTruths = (run: string): Promise<GraspTruth[]> => getJson(`/api/runs/${encodeURIComponent(run)}/truth`);

export const correctTruth = (run: string, grasp: number, request: TruthCorrection): Promise<GraspTruth> =>
  fetchJson("PUT", `/api/runs/${encodeURIComponent(run)}/grasps/${grasp}/truth`, TIMEOUT_MS, request);

export const addMark = (request: MarkRequest): Promise<Mark> => postJson("/api/marks", request);

export const getMarks = (run: string): Promise<Mark[]> => getJson(`/api/runs/${encodeURIComponent(run)}/marks`);

export const deleteMark = (mark: Mark, by: string | null): Promise<Mark> => {
  const asked = new URLSearchParams({ version: String(mark.version), ...(by === null ? {} : { by }) });
  return fetchJson("DELETE", `/api/marks/${encodeURIComponent(mark.id)}?${asked}`, TIMEOUT_MS);
};

export const beginLabSession = (request: LabSessionRequest): Promise<LabSession> => postJson("/api/lab-sessions", request);

export const changeLabSession = (id: string, request: LabSessionChange): Promise<LabSession> =>
  fetchJson("PUT", `/api/lab-sessions/${encodeURIComponent(id)}`, TIMEOUT_MS, request);

export const endLabSession = (by: string | null): Promise<LabSession> =>
  fetchJson("DELETE", `/api/lab-sessions/current${by === null ? "" : `?by=${encodeURIComponent(by)}`}`, TIMEOUT_MS);

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

async function fetchJson<Answer>(method: string, path: string, timeoutMs: number, body?: unknown): Promise<Answer> {
  let response: Response;
  try {
    response = await fetch(path, {
      method,
      cache: "no-store",
      signal: AbortSignal.timeout(timeoutMs),
      ...encode(body),
    });
    readServerDate(response.headers.get("Date"));
    if (response.ok) return (response.status === 204 ? null : await response.json()) as Answer;
  } catch (error) {
    const timedOut = error instanceof DOMException && error.name === "TimeoutError";
    throw new Unreachable(timedOut ? `no answer within ${timeoutMs / 1000} s` : "the server cannot be reached");
  }
  if (response.status === UNAUTHORIZED && path !== SESSION) notifySignedOut();
  throw new Refused(await problemText(response));
}

function encode(body: unknown): RequestInit {
  if (body === undefined) return {};
  if (body instanceof Blob) return { body, headers: { "Content-Type": "application/octet-stream" } };
  return { body: JSON.stringify(body), headers: { "Content-Type": "application/json" } };
}

async function problemText(response: Response): Promise<string> {
  const isProblem = response.headers.get("Content-Type")?.includes("problem+json");
  const problem = isProblem ? ((await response.json().catch(() => null)) as Partial<Problem> | null) : null;
  if (!problem) return `the server answered ${response.status} ${response.statusText}`.trim();
  const detail = problem.detail || problem.title || `error ${response.status}`;
  const fields = (problem.errors ?? [])
    .filter(({ message }) => !message || !detail.includes(message))
    .map((error) => Object.values(error).join(": "));
  return [detail, ...fields].join(" · ");
}

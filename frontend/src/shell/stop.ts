import { byId, setAttribute, setData, setHidden, setText } from "../dom";
import { clockTime, count } from "../format";
import type { Model } from "../live/model";
import { messageOf, Refused, sendStop } from "../live/rest";
import type { StopAnswer } from "../wire";
import { pageAlarm, type ShownAlarm } from "./alarms";
import type { Person } from "./person";

const SUCCESS_SHOWN_MS = 15_000;
/** Above this number of characters a message is smaller, so that it fits into the room of messages. */
const LONG_TEXT = 90;

/** The STOP button: stops the run without a question and says what was stopped. */
export class StopButton {
  private failedAt: number | null = null;
  private latest = 0;
  private stoppedRun: string | null = null;
  private readonly message = byId("stop-message");

  constructor(
    private readonly model: Model,
    private readonly person: Person,
  ) {
    byId("stop").addEventListener("click", () => void this.stop());
  }

  async stop(): Promise<void> {
    const attempt = ++this.latest;
    const pressedAt = performance.now();
    this.showMessage("Stopping…", "pending");
    setAttribute(byId("stop"), "aria-busy", "true");
    try {
      const answer = await sendStop(this.person.name);
      if (attempt !== this.latest) return;
      this.failedAt = null;
      this.stoppedRun = answer.run?.id ?? null;
      this.showMessage(`${inWords(answer, this.model.hasMotor)} (${clockTime(pressedAt)})`, "done");
      setTimeout(() => attempt === this.latest && setHidden(this.message, true), SUCCESS_SHOWN_MS);
    } catch (error) {
      if (attempt !== this.latest) return;
      this.failedAt = pressedAt;
      const what = error instanceof Refused ? "STOP was refused" : "STOP could not be sent";
      const advice = this.model.hasMotor ? " – use the hardware switch" : "";
      this.showMessage(`${what}${advice}. ${clockTime(pressedAt)}: ${messageOf(error)}.`, "failed");
    } finally {
      if (attempt === this.latest) setAttribute(byId("stop"), "aria-busy", "false");
    }
  }

  /** Hides the message about the last STOP as soon as another run moves the motor. */
  render(runningRun: string | null): void {
    if (runningRun !== null && runningRun !== this.stoppedRun && this.message.dataset.outcome === "done") {
      setHidden(this.message, true);
    }
  }

  /** Returns an alarm for a STOP that failed, until another STOP succeeds or the tool is known to stand still. */
  alarms(nowMs: number): ShownAlarm[] {
    if (this.failedAt === null) return [];
    if (this.model.standsStillSince(this.failedAt, nowMs)) {
      this.standsStill(this.failedAt);
      return [];
    }
    return [pageAlarm("page:stop", "high", this.model.hasMotor ? "STOP not sent: use the hardware switch" : "STOP not sent: nothing moves, but the run goes on", this.failedAt)];
  }

  private standsStill(pressedAt: number): void {
    const attempt = this.latest;
    const { last_run: run } = this.model.state ?? { last_run: null };
    this.failedAt = null;
    this.stoppedRun = null;
    const why = run?.why ? ` Last run ${run.state}: ${run.why}.` : "";
    const now = this.model.hasMotor ? "The motor is at zero now" : "No run is under way now";
    this.showMessage(`${now}. STOP of ${clockTime(pressedAt)} did not come through.${why}`, "done");
    setTimeout(() => attempt === this.latest && setHidden(this.message, true), SUCCESS_SHOWN_MS);
  }

  private showMessage(text: string, outcome: "pending" | "done" | "failed"): void {
    setText(this.message, text);
    setData(this.message, "long", String(text.length > LONG_TEXT));
    setData(this.message, "outcome", outcome);
    setHidden(this.message, false);
  }
}

function inWords({ stopped, run }: StopAnswer, hasMotor: boolean): string {
  const atZero = hasMotor ? " The motor is at zero." : "";
  if (!stopped) return `STOP: nothing was running.${atZero}`;
  const after = run ? ` ${run.protocol} after ${count(run.grasps, "grasp")}` : " the run";
  return `STOPPED${after}.${atZero}`;
}

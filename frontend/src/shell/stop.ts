import { byId, setAttribute, setData, setHidden, setText } from "../dom";
import { clockTime, count } from "../format";
import { Refused, sendStop } from "../live/rest";
import type { StopAnswer } from "../wire";
import type { ShownAlarm } from "./alarms";

const SUCCESS_SHOWN_MS = 15_000;

/** One button, one key, no question: stops whatever runs and says what it did. */
export class StopButton {
  private failedAt: number | null = null;
  private latest = 0;
  private stoppedRun: string | null = null;
  private readonly message = byId("stop-message");

  constructor(private readonly onStop: () => void) {
    byId("stop").addEventListener("click", () => void this.stop());
  }

  async stop(): Promise<void> {
    const attempt = ++this.latest;
    const pressedAt = performance.now();
    this.onStop();
    this.say("Stopping…", "pending");
    setAttribute(byId("stop"), "aria-busy", "true");
    try {
      const answer = await sendStop();
      if (attempt !== this.latest) return;
      this.failedAt = null;
      this.stoppedRun = answer.run?.id ?? null;
      this.say(`${this.inWords(answer)} (${clockTime(pressedAt)})`, "done");
      setTimeout(() => attempt === this.latest && setHidden(this.message, true), SUCCESS_SHOWN_MS);
    } catch (error) {
      if (attempt !== this.latest) return;
      this.failedAt = pressedAt;
      const why = error instanceof Error ? error.message : String(error);
      const what = error instanceof Refused ? "STOP was refused" : "STOP could not be sent";
      this.say(`${what} – use the hardware switch. ${clockTime(pressedAt)}: ${why}.`, "failed");
    } finally {
      if (attempt === this.latest) setAttribute(byId("stop"), "aria-busy", "false");
    }
  }

  /** What a stop did is no longer true once another run moves the motor. */
  render(runningRun: string | null): void {
    if (runningRun !== null && runningRun !== this.stoppedRun && this.message.dataset.outcome === "done") {
      setHidden(this.message, true);
    }
  }

  /** A stop that did not reach the tool stays an alarm until one does. */
  alarms(): ShownAlarm[] {
    if (this.failedAt === null) return [];
    return [{ id: "page:stop", priority: "high", text: "STOP not sent: use the hardware switch", beganAt: this.failedAt }];
  }

  private inWords({ stopped, run }: StopAnswer): string {
    if (!stopped) return "STOP: nothing was running. The motor is at zero.";
    const after = run ? ` ${run.protocol} after ${count(run.grasps, "grasp")}` : " the run";
    return `STOPPED${after}. The motor is at zero.`;
  }

  private say(text: string, outcome: "pending" | "done" | "failed"): void {
    setText(this.message, text);
    setData(this.message, "outcome", outcome);
    setHidden(this.message, false);
  }
}

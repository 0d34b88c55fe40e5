import { find, setAttribute, setData, setHidden, setText } from "../dom";
import { count, elapsed } from "../format";
import { serverTimeMs } from "../live/clock";
import { messageOf, postJson } from "../live/rest";
import type { Person } from "../shell/person";
import type { StopRequest, StudyRun } from "../wire";

/** Shows the running study: its progress, the time left, and a Stop button. */
export class RunningStudy {
  private readonly stop: HTMLButtonElement;
  private readonly progress: HTMLProgressElement;
  private readonly message: HTMLElement;
  private run: StudyRun | null = null;

  /** `onStop` is called after a stop request, whether it succeeded or not. */
  constructor(
    private readonly root: HTMLElement,
    private readonly person: Person,
    private readonly onStop: () => void,
  ) {
    this.stop = find(root, "study-stop", HTMLButtonElement);
    this.progress = find(root, "study-progress", HTMLProgressElement);
    this.message = find(root, "study-stop-message");
    this.stop.addEventListener("click", () => void this.ask());
  }

  show(run: StudyRun | null): void {
    if (run?.id !== this.run?.id) this.showMessage("", "done");
    this.run = run;
    setHidden(find(this.root, "study-none"), run !== null);
    setHidden(find(this.root, "study-now"), run === null);
    if (!run) return;
    setText(find(this.root, "study-now-name"), run.study);
    setText(find(this.root, "study-now-title"), run.title);
    const by = run.by === null ? "" : `, started by ${run.by}`;
    setText(find(this.root, "study-now-facts"), `· ${run.grasps} of each, seed ${run.seed}${by}`);
    setText(find(this.root, "study-now-done"), run.of === null ? "Preparing…" : `${run.done} of ${count(run.of, "case")}`);
    if (run.of === null) return this.progress.removeAttribute("value");
    setAttribute(this.progress, "max", String(run.of));
    setAttribute(this.progress, "value", String(run.done));
  }

  render(): void {
    if (!this.run) return;
    const ms = serverTimeMs() - Date.parse(this.run.started_at);
    setText(find(this.root, "study-now-time"), `${elapsed(ms)}${leftInWords(this.run, ms)}`);
  }

  private async ask(): Promise<void> {
    if (!this.run || this.stop.ariaBusy === "true") return;
    const request: StopRequest = { by: this.person.name };
    setAttribute(this.stop, "aria-busy", "true");
    try {
      await postJson<StudyRun>(`/api/studies/${encodeURIComponent(this.run.id)}/stop`, request);
      this.showMessage("", "done");
    } catch (error) {
      this.showMessage(`Not stopped: ${messageOf(error)}`, "failed");
    } finally {
      setAttribute(this.stop, "aria-busy", "false");
    }
    this.onStop();
  }

  private showMessage(text: string, outcome: "done" | "failed"): void {
    setText(this.message, text);
    setData(this.message, "outcome", outcome);
  }
}

/** Estimates the time left, if each further case takes as long as the average so far. */
function leftInWords({ done, of }: StudyRun, ms: number): string {
  if (of === null || done === 0) return " so far";
  const minutes = (ms * (of - done)) / done / 60_000;
  return minutes < 1 ? " so far, less than a minute left" : ` so far, about ${Math.round(minutes)}\u202fmin left`;
}

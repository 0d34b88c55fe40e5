import { setData, setText } from "../dom";
import { clockTime } from "../format";
import { getJson, messageOf, Refused } from "../live/rest";

const AFTER_FAILURE_MS = 3000;

export interface PolledOptions<Answer> {
  path: string;
  /** Subject of a sentence: "The list". */
  title: string;
  /** Gets `data-state`: loading, ready, failed, or old if it shows an earlier answer. Contains a `.state-line`. */
  section: HTMLElement;
  /** Shows an answer, and returns the time until the next request, ms. */
  onAnswer: (answer: Answer) => number;
}

/** Keeps a section up to date by repeated requests, and says so when one fails. */
export class Polled<Answer> {
  private readonly line: Element | null;
  private timer = 0;
  private latest = 0;
  private answeredMs: number | null = null;

  constructor(private readonly options: PolledOptions<Answer>) {
    this.line = options.section.querySelector(".state-line");
    void this.ask();
  }

  /** Asks at once. The answer to an earlier request is ignored. */
  refresh(): void {
    clearTimeout(this.timer);
    void this.ask();
  }

  close(): void {
    this.latest += 1;
    clearTimeout(this.timer);
  }

  private async ask(): Promise<void> {
    const attempt = ++this.latest;
    let answer: Answer;
    try {
      answer = await getJson<Answer>(this.options.path);
    } catch (error) {
      if (attempt === this.latest) this.fail(error);
      return;
    }
    if (attempt !== this.latest) return;
    this.answeredMs = performance.now();
    this.showState("ready", "");
    this.askAfter(this.options.onAnswer(answer));
  }

  private fail(error: unknown): void {
    const how = error instanceof Refused ? "cannot be read, the server says" : "cannot be read";
    const old = this.answeredMs === null ? "" : ` What stands here is from ${clockTime(this.answeredMs)}.`;
    const why = messageOf(error).replace(/\.$/, "");
    this.showState(this.answeredMs === null ? "failed" : "old", `${this.options.title} ${how}: ${why}. Trying again.${old}`);
    this.askAfter(AFTER_FAILURE_MS);
  }

  private askAfter(ms: number): void {
    this.timer = window.setTimeout(() => void this.ask(), ms);
  }

  private showState(state: "ready" | "failed" | "old", text: string): void {
    setData(this.options.section, "state", state);
    if (this.line) setText(this.line, text);
  }
}

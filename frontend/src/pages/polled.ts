import { setData, setText } from "../dom";
import { clockTime } from "../format";
import { getJson, messageOf, Refused } from "../live/rest";

const AFTER_FAILURE_MS = 3000;

export interface Subject<Answer> {
  path: string;
  /** In a sentence: "The list". */
  what: string;
  /** Gets `data-state`: loading, ready, failed, or old when only an earlier answer is shown. Has a `.state-line`. */
  section: HTMLElement;
  /** Shows an answer and returns after how many milliseconds to ask again. */
  take: (answer: Answer) => number;
}

/** Keeps a section up to date: asks, waits after each answer, asks again; says so where it cannot. */
export class Polled<Answer> {
  private readonly line: Element | null;
  private timer = 0;
  private latest = 0;
  private answeredMs: number | null = null;

  constructor(private readonly subject: Subject<Answer>) {
    this.line = subject.section.querySelector(".state-line");
    void this.ask();
  }

  /** Asks at once; whatever was asked before is out of date. */
  now(): void {
    clearTimeout(this.timer);
    void this.ask();
  }

  close(): void {
    this.latest += 1;
    clearTimeout(this.timer);
  }

  private async ask(): Promise<void> {
    const asked = ++this.latest;
    let answer: Answer;
    try {
      answer = await getJson<Answer>(this.subject.path);
    } catch (error) {
      if (asked === this.latest) this.fail(error);
      return;
    }
    if (asked !== this.latest) return;
    this.answeredMs = performance.now();
    this.say("ready", "");
    this.askAfter(this.subject.take(answer));
  }

  private fail(error: unknown): void {
    const how = error instanceof Refused ? "cannot be read, the server says" : "cannot be read";
    const old = this.answeredMs === null ? "" : ` What stands here is from ${clockTime(this.answeredMs)}.`;
    const why = messageOf(error).replace(/\.$/, "");
    this.say(this.answeredMs === null ? "failed" : "old", `${this.subject.what} ${how}: ${why}. Trying again.${old}`);
    this.askAfter(AFTER_FAILURE_MS);
  }

  private askAfter(ms: number): void {
    this.timer = window.setTimeout(() => void this.ask(), ms);
  }

  private say(state: "ready" | "failed" | "old", text: string): void {
    setData(this.subject.section, "state", state);
    if (this.line) setText(this.line, text);
  }
}

import { byId, setData, setHidden, setText } from "../dom";
import { clockTime, elapsed } from "../format";
import type { Model } from "../live/model";
import type { Alarm, Priority } from "../wire";

/** An alarm as the bar shows it; `beganAt` in page time. */
export interface ShownAlarm {
  id: string;
  priority: Priority;
  text: string;
  beganAt: number;
}

const RANK: Record<Priority, number> = { high: 3, medium: 2, low: 1 };
const WORD: Record<Priority, string> = { high: "HIGH", medium: "MEDIUM", low: "LOW" };

/** The highest alarm, always in sight. */
export class AlarmBar {
  private readonly bar = byId("alarm-bar");
  private announced = "";
  private last: { text: string; endedAt: number } | null = null;
  private top: ShownAlarm | null = null;

  constructor(private readonly model: Model) {}

  /** Shows the server's alarms together with those that the page raises itself. */
  render(ofPage: ShownAlarm[], nowMs: number): void {
    const alarms = [...ofPage, ...[...this.model.alarms.values()].map((alarm) => this.shown(alarm))];
    alarms.sort((a, b) => RANK[b.priority] - RANK[a.priority] || b.beganAt - a.beganAt);
    const top = alarms[0] ?? null;
    if (this.top && !alarms.some((alarm) => alarm.id === this.top?.id)) {
      this.last = { text: this.top.text, endedAt: nowMs };
    }
    this.top = top;
    setData(this.bar, "priority", top?.priority ?? "none");
    setText(byId("alarm-priority"), top ? WORD[top.priority] : "");
    setText(byId("alarm-text"), top ? top.text : "No alarms");
    setText(byId("alarm-since"), top ? since(top, nowMs) : this.lastAlarm());
    setHidden(byId("alarm-more"), alarms.length < 2);
    setText(byId("alarm-more"), `+${alarms.length - 1} more`);
    this.announce(top);
  }

  private shown(alarm: Alarm): ShownAlarm {
    return { id: alarm.id, priority: alarm.priority, text: inWords(alarm), beganAt: this.model.clock.toPage(alarm.began_ms) };
  }

  private lastAlarm(): string {
    return this.last ? `Last: ${this.last.text}, ended ${clockTime(this.last.endedAt)}` : "";
  }

  /** Speaks once for each alarm, not at each new value. */
  private announce(top: ShownAlarm | null): void {
    const key = top ? `${top.id} ${top.priority}` : "";
    if (key === this.announced) return;
    this.announced = key;
    setText(byId("alarm-live"), top ? `${WORD[top.priority]} alarm: ${top.text}` : "Alarm over");
  }
}

/** The server's words, with value and limit unless they say them already. */
function inWords({ text, value, limit, unit }: Alarm): string {
  if (value === null || /\d/.test(text)) return text;
  const ofLimit = limit === null ? "" : `, limit ${limit.toFixed(2)}\u202f${unit ?? ""}`;
  return `${text}: ${value.toFixed(2)}\u202f${unit ?? ""}${ofLimit}`;
}

function since(alarm: ShownAlarm, nowMs: number): string {
  if (!Number.isFinite(alarm.beganAt)) return "";
  return `since ${clockTime(alarm.beganAt)} (${elapsed(nowMs - alarm.beganAt)})`;
}

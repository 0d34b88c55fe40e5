import { byId, create, setAttribute, setData, setHidden, setText } from "../dom";
import { clockTime, elapsed } from "../format";
import type { Model } from "../live/model";
import { acknowledgeAlarm, messageOf } from "../live/rest";
import type { Alarm, Priority } from "../wire";
import type { Person } from "./person";
import type { AlarmSound } from "./sound";

/** An alarm as the bar shows it; `beganAt` in page time. */
export interface ShownAlarm {
  id: string;
  priority: Priority;
  text: string;
  beganAt: number;
  /** The cause is gone, but nobody has acknowledged it. */
  latched: boolean;
  acknowledgedBy: string | null;
}

/** An alarm that the page raises itself. */
export const pageAlarm = (id: string, priority: ShownAlarm["priority"], text: string, beganAt: number): ShownAlarm => ({
  id,
  priority,
  text,
  beganAt,
  latched: false,
  acknowledgedBy: null,
});

const RANK: Record<Priority, number> = { high: 3, medium: 2, low: 1 };
const WORD: Record<Priority, string> = { high: "HIGH", medium: "MEDIUM", low: "LOW" };

/** The highest alarm, always in sight; the others on request. */
export class AlarmBar {
  private readonly bar = byId("alarm-bar");
  private readonly list = byId("alarm-list");
  private announced = "";
  private last: { text: string; endedAt: number } | null = null;
  private shown: ShownAlarm[] = [];
  private listOpen = false;
  /** Alarms that this page raises itself are acknowledged here: the server may be out of reach. */
  private readonly ofPageAcknowledged = new Map<string, string>();

  constructor(
    private readonly model: Model,
    private readonly sound: AlarmSound,
    private readonly person: Person,
  ) {
    byId("acknowledge").addEventListener("click", () => this.acknowledge());
    byId("alarm-more").addEventListener("click", () => this.toggleList());
  }

  /** Shows the server's alarms together with those that the page raises itself. */
  render(ofPage: ShownAlarm[], nowMs: number): void {
    for (const id of this.ofPageAcknowledged.keys()) {
      if (!ofPage.some((alarm) => keyOf(alarm) === id)) this.ofPageAcknowledged.delete(id);
    }
    const own = ofPage.map((alarm) => ({ ...alarm, acknowledgedBy: this.ofPageAcknowledged.get(keyOf(alarm)) ?? null }));
    const alarms = [...own, ...[...this.model.alarms.values()].map((alarm) => this.asShown(alarm))];
    alarms.sort(byUrgency);
    const before = this.shown[0];
    if (before && !alarms.some(({ id }) => id === before.id)) this.last = { text: before.text, endedAt: nowMs };
    this.shown = alarms;
    this.renderBar(alarms, nowMs);
    this.renderList(alarms, nowMs);
    const loud = alarms.find(({ acknowledgedBy }) => acknowledgedBy === null);
    this.sound.render(loud ? keyOf(loud) : null, loud?.priority ?? null, nowMs);
    this.announce(alarms[0] ?? null);
  }

  /** The highest one that nobody has acknowledged yet; one that the bar does not show is shown first. */
  acknowledge(): void {
    const alarm = this.shown.find((each) => this.canAcknowledge(each));
    if (!alarm) return;
    if (alarm === this.shown[0] || this.listOpen) this.acknowledgeOne(alarm);
    else this.toggleList();
  }

  toggleList(): void {
    this.listOpen = !this.listOpen && this.shown.length > 0;
    setAttribute(byId("alarm-more"), "aria-expanded", String(this.listOpen));
  }

  private acknowledgeOne(alarm: ShownAlarm): void {
    if (alarm.id.startsWith("page:")) {
      this.ofPageAcknowledged.set(keyOf(alarm), this.person.name ?? "you");
      return;
    }
    this.person.withName((by) => {
      acknowledgeAlarm(alarm.id, alarm.priority, by).catch((error: unknown) => {
        this.model.lastEvent = `Not acknowledged: ${messageOf(error)}`;
      });
    });
  }

  /** The page's own alarms are anybody's. */
  private canAcknowledge({ id, acknowledgedBy }: ShownAlarm): boolean {
    return acknowledgedBy === null && (id.startsWith("page:") || this.person.may("operator"));
  }

  private renderBar(alarms: ShownAlarm[], nowMs: number): void {
    const top = alarms[0];
    setData(this.bar, "priority", top?.priority ?? "none");
    setData(this.bar, "quiet", String(top !== undefined && top.acknowledgedBy !== null));
    setText(byId("alarm-priority"), top ? WORD[top.priority] : "");
    setText(byId("alarm-text"), top?.text ?? (this.model.state ? "No alarms" : "Alarms are not known yet"));
    setText(byId("alarm-since"), top ? since(top, nowMs) : this.lastAlarm());
    const more = byId("alarm-more");
    setHidden(more, alarms.length < 2);
    setText(more, `+${alarms.length - 1} more`);
    setHidden(byId("acknowledge"), !alarms.some((alarm) => this.canAcknowledge(alarm)));
  }

  private renderList(alarms: ShownAlarm[], nowMs: number): void {
    if (alarms.length < 2) this.listOpen = false;
    setHidden(this.list, !this.listOpen);
    if (!this.listOpen) return;
    const lines = alarms.map((alarm) => `${WORD[alarm.priority]}: ${alarm.text} ${since(alarm, nowMs)}`);
    if (this.list.childElementCount !== lines.length) this.list.replaceChildren(...lines.map(() => create("li")));
    lines.forEach((line, i) => {
      const item = this.list.children[i] as HTMLElement;
      setText(item, line);
      setData(item, "priority", alarms[i]?.priority ?? "low");
    });
  }

  private asShown(alarm: Alarm): ShownAlarm {
    return {
      id: alarm.id,
      priority: alarm.priority,
      text: inWords(alarm),
      beganAt: this.model.clock.toPage(alarm.began_ms),
      latched: !alarm.active,
      acknowledgedBy: alarm.acknowledged_by,
    };
  }

  private lastAlarm(): string {
    return this.last ? `Last: ${this.last.text}, ended ${clockTime(this.last.endedAt)}` : "";
  }

  /** Speaks once for each alarm, not at each new value. */
  private announce(top: ShownAlarm | null): void {
    const key = top ? `${keyOf(top)} ${top.latched}` : "";
    if (key === this.announced) return;
    this.announced = key;
    setText(byId("alarm-live"), top ? `${WORD[top.priority]} alarm: ${top.text}` : "Alarm over");
  }
}

const keyOf = ({ id, priority }: ShownAlarm): string => `${id} ${priority}`;

/** The higher priority first, then what nobody has acknowledged, then what is not over yet, then the newer one. */
const byUrgency = (a: ShownAlarm, b: ShownAlarm): number =>
  RANK[b.priority] - RANK[a.priority] ||
  Number(a.acknowledgedBy !== null) - Number(b.acknowledgedBy !== null) ||
  Number(a.latched) - Number(b.latched) ||
  b.beganAt - a.beganAt;

/** The server's words, with value and limit unless they say them already. */
function inWords({ text, value, limit, unit }: Alarm): string {
  if (value === null || /\d/.test(text)) return text;
  const ofLimit = limit === null ? "" : `, limit ${limit.toFixed(2)}\u202f${unit ?? ""}`;
  return `${text}: ${value.toFixed(2)}\u202f${unit ?? ""}${ofLimit}`;
}

function since(alarm: ShownAlarm, nowMs: number): string {
  const began = Number.isFinite(alarm.beganAt) ? `since ${clockTime(alarm.beganAt)} (${elapsed(nowMs - alarm.beganAt)})` : "";
  if (alarm.latched) return `${began}, over by now: acknowledge it`;
  return alarm.acknowledgedBy === null ? began : `${began}, seen by ${alarm.acknowledgedBy}`;
}

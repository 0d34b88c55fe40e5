import { byId, create, setAttribute, setData, setHidden, setText } from "../dom";
import { clockTime, elapsed } from "../format";
import type { Model } from "../live/model";
import { acknowledgeAlarm, messageOf } from "../live/rest";
import type { Alarm, Priority } from "../wire";
import type { Person } from "./person";
import type { AlarmSound } from "./sound";

/** An alarm as the bar shows it. `beganAt` is in page time, ms. */
export interface ShownAlarm {
  id: string;
  priority: Priority;
  text: string;
  beganAt: number;
  /** The cause has ended, but the alarm waits for a person to acknowledge it. */
  latched: boolean;
  acknowledgedBy: string | null;
}

/** Builds an alarm that the page raises itself. */
export const pageAlarm = (id: string, priority: ShownAlarm["priority"], text: string, beganAt: number): ShownAlarm => ({
  id,
  priority,
  text,
  beganAt,
  latched: false,
  acknowledgedBy: null,
});

const RANK: Record<Priority, number> = { high: 3, medium: 2, low: 1 };
/** Above this number of characters the bar's text is smaller, so that it still fits on two lines. */
const LONG_TEXT = 60;
/** Above this number it may be cut there; the list has all of it. */
const MAX_WHOLE_TEXT = 90;
const PRIORITY_TEXT: Record<Priority, string> = { high: "HIGH", medium: "MEDIUM", low: "LOW" };

/** Shows the highest alarm at all times, and a list of all alarms on request. */
export class AlarmBar {
  private readonly bar = byId("alarm-bar");
  private readonly list = byId("alarm-list");
  private announced = "";
  private last: { text: string; endedAt: number } | null = null;
  private shown: ShownAlarm[] = [];
  private listOpen = false;
  /** Who acknowledged each of the page's own alarms. The page keeps this, since the server may be unreachable. */
  private readonly acknowledgedHere = new Map<string, string>();

  constructor(
    private readonly model: Model,
    private readonly sound: AlarmSound,
    private readonly person: Person,
  ) {
    byId("acknowledge").addEventListener("click", () => this.acknowledge());
    byId("alarm-more").addEventListener("click", () => this.toggleList());
  }

  /** Shows the server's alarms together with those that the page raises itself. */
  render(pageAlarms: ShownAlarm[], nowMs: number): void {
    for (const id of this.acknowledgedHere.keys()) {
      if (!pageAlarms.some((alarm) => keyOf(alarm) === id)) this.acknowledgedHere.delete(id);
    }
    const ownAlarms = pageAlarms.map((alarm) => ({ ...alarm, acknowledgedBy: this.acknowledgedHere.get(keyOf(alarm)) ?? null }));
    const alarms = [...ownAlarms, ...[...this.model.alarms.values()].map((alarm) => this.asShown(alarm))];
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

  /** Acknowledges the highest open alarm. If the bar does not show that alarm, opens the list first. */
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
      this.acknowledgedHere.set(keyOf(alarm), this.person.name ?? "you");
      return;
    }
    this.person.withName((by) => {
      acknowledgeAlarm(alarm.id, alarm.priority, by).catch((error: unknown) => {
        this.model.lastEvent = `Not acknowledged: ${messageOf(error)}`;
      });
    });
  }

  /** Any person may acknowledge the page's own alarms; the server's need an operator. */
  private canAcknowledge({ id, acknowledgedBy }: ShownAlarm): boolean {
    return acknowledgedBy === null && (id.startsWith("page:") || this.person.may("operator"));
  }

  private renderBar(alarms: ShownAlarm[], nowMs: number): void {
    const top = alarms[0];
    setData(this.bar, "priority", top?.priority ?? "none");
    setData(this.bar, "quiet", String(top !== undefined && top.acknowledgedBy !== null));
    setText(byId("alarm-priority"), top ? PRIORITY_TEXT[top.priority] : "");
    setData(this.bar, "long", String((top?.text.length ?? 0) > LONG_TEXT));
    setText(byId("alarm-text"), top?.text ?? (this.model.state ? "No alarms" : "Alarms are not known yet"));
    setText(byId("alarm-since"), top ? sinceText(top, nowMs) : this.lastAlarm());
    const more = byId("alarm-more");
    setHidden(more, !this.hasList(alarms));
    setText(more, alarms.length === 1 ? "All of it" : `+${Math.max(0, alarms.length - 1)} more`);
    setHidden(byId("acknowledge"), !alarms.some((alarm) => this.canAcknowledge(alarm)));
  }

  private renderList(alarms: ShownAlarm[], nowMs: number): void {
    if (!this.hasList(alarms)) this.listOpen = false;
    setHidden(this.list, !this.listOpen);
    if (!this.listOpen) return;
    const lines = alarms.map((alarm) => `${PRIORITY_TEXT[alarm.priority]}: ${alarm.text} ${sinceText(alarm, nowMs)}`);
    if (this.list.childElementCount !== lines.length) this.list.replaceChildren(...lines.map(() => create("li")));
    lines.forEach((line, i) => {
      const item = this.list.children[i] as HTMLElement;
      setText(item, line);
      setData(item, "priority", alarms[i]?.priority ?? "low");
    });
  }

  /** Whether the list shows more than the bar does: other alarms, or the end of a long text. */
  private readonly hasList = (alarms: ShownAlarm[]): boolean => alarms.length > 1 || (alarms[0]?.text.length ?? 0) > MAX_WHOLE_TEXT;

  private asShown(alarm: Alarm): ShownAlarm {
    return {
      id: alarm.id,
      priority: alarm.priority,
      text: alarmText(alarm),
      beganAt: this.model.clock.toPage(alarm.began_ms),
      latched: !alarm.active,
      acknowledgedBy: alarm.acknowledged_by,
    };
  }

  private lastAlarm(): string {
    return this.last ? `Last: ${this.last.text}, ended ${clockTime(this.last.endedAt)}` : "";
  }

  /** Announces each alarm to screen readers once, not at each new value. */
  private announce(top: ShownAlarm | null): void {
    const key = top ? `${keyOf(top)} ${top.latched}` : "";
    if (key === this.announced) return;
    this.announced = key;
    setText(byId("alarm-live"), top ? `${PRIORITY_TEXT[top.priority]} alarm: ${top.text}` : "Alarm over");
  }
}

const keyOf = ({ id, priority }: ShownAlarm): string => `${id} ${priority}`;

/** Sorts by priority, then unacknowledged before acknowledged, then active before latched, then newest first. */
const byUrgency = (a: ShownAlarm, b: ShownAlarm): number =>
  RANK[b.priority] - RANK[a.priority] ||
  Number(a.acknowledgedBy !== null) - Number(b.acknowledgedBy !== null) ||
  Number(a.latched) - Number(b.latched) ||
  b.beganAt - a.beganAt;

/** Returns the server's text; that of a force after the force and the injury threshold. */
function alarmText({ kind, text, value, limit, unit }: Alarm): string {
  if (kind !== "force" || value === null) return text;
  const threshold = limit === null ? "" : `, threshold ${limit.toFixed(2)}\u202f${unit ?? ""}`;
  return `${value.toFixed(2)}\u202f${unit ?? ""}${threshold}: ${text}`;
}

function sinceText(alarm: ShownAlarm, nowMs: number): string {
  const began = Number.isFinite(alarm.beganAt) ? `since ${clockTime(alarm.beganAt)} (${elapsed(nowMs - alarm.beganAt)})` : "";
  if (alarm.latched) return `${began}, over by now: acknowledge it`;
  return alarm.acknowledgedBy === null ? began : `${began}, seen by ${alarm.acknowledgedBy}`;
}

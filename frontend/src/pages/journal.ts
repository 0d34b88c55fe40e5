import { create, find, setAttribute, setData, setHidden, setText } from "../dom";
import type { JournalCheck, JournalEntry, JournalKind } from "../wire";
import { Polled } from "./polled";
import { day, moment, Rows, timeOfDay, type Row } from "./rows";

const EVERY_MS = 5000;
const CHECKED_EVERY_MS = 30_000;
const MAX_ENTRIES = 200;
const KIND: Record<JournalKind, string> = { event: "Event", run: "Run", alarm: "Alarm", acknowledged: "Acknowledged", deleted: "Deleted", restored: "Restored", emptied: "Removed", request: "Request", chain: "Chain", access: "Access", truth: "Truth", mark: "Mark", session: "Session" };

type Choice = JournalKind | "all";

/** Lists who did what and when, newest first, filtered by kind. */
export class Journal {
  private readonly polled: Polled<JournalEntry[]>;
  private readonly chainCheck: Polled<JournalCheck>;
  private readonly rows: Rows<JournalEntry>;
  private readonly buttons = new Map<Choice, HTMLButtonElement>();
  private entries: JournalEntry[] = [];
  private choice: Choice = "all";

  constructor(private readonly root: HTMLElement) {
    this.rows = new Rows(find(root, "journal-body"), (entry) => JSON.stringify(entry), makeRow);
    for (const [choice, text] of Object.entries({ all: "All", ...KIND }) as [Choice, string][]) {
      const button = create("button", "", text);
      button.type = "button";
      button.addEventListener("click", () => this.choose(choice));
      this.buttons.set(choice, button);
    }
    find(root, "journal-kinds").replaceChildren(...this.buttons.values());
    const [path, section] = [`/api/journal?most=${MAX_ENTRIES}`, find(root, "journal")];
    this.polled = new Polled({ path, title: "The journal", section, onAnswer: (entries) => this.onEntries(entries) });
    this.chainCheck = new Polled({ path: "/api/audit/check", title: "Whether it is whole", section: find(root, "chain"), onAnswer: (check) => showChain(root, check) });
  }

  close(): void {
    this.polled.close();
    this.chainCheck.close();
  }

  private onEntries(entries: JournalEntry[]): number {
    this.entries = entries;
    this.show();
    return EVERY_MS;
  }

  private choose(choice: Choice): void {
    this.choice = choice;
    this.show();
  }

  private show(): void {
    const shown = this.entries.filter(({ kind }) => this.choice === "all" || kind === this.choice);
    this.rows.show(shown);
    for (const [choice, button] of this.buttons) setAttribute(button, "aria-pressed", String(choice === this.choice));
    const newest = this.entries.length === MAX_ENTRIES ? `the newest ${MAX_ENTRIES}` : String(this.entries.length);
    setText(find(this.root, "journal-count"), `${shown.length} of ${newest}`);
    setHidden(find(this.root, "journal-box"), shown.length === 0);
    setHidden(find(this.root, "journal-empty"), shown.length > 0);
    setText(find(this.root, "journal-empty"), this.entries.length === 0 ? "Nothing has happened yet." : "No line of this kind.");
  }
}

function showChain(root: HTMLElement, { problem, notes, lines, checked_at }: JournalCheck): number {
  const found = problem === null ? `Whole: ${lines} lines, none changed or missing.` : `Not as it was written: ${problem}.`;
  setText(find(root, "chain-found"), [found, ...notes.map((note) => `Note: ${note}.`), `Checked ${timeOfDay(checked_at)}.`].join(" "));
  setData(find(root, "chain-found"), "warn", String(problem !== null));
  return CHECKED_EVERY_MS;
}

function makeRow(entry: JournalEntry): Row<JournalEntry> {
  const element = create("tr", entry.kind);
  const [time, kind, what] = [create("td"), create("td", "roomy", KIND[entry.kind]), create("td", "", entry.text)];
  time.append(moment(entry.at, timeOfDay(entry.at), create("small", "", day(entry.at))));
  const value = valueInWords(entry);
  const facts = [KIND[entry.kind], entry.by, value].filter(Boolean).join(" · ");
  what.append(create("small", "narrow", facts));
  const origin = [entry.reason, entry.client && `from ${entry.client}`].filter(Boolean).join(" · ");
  if (origin) what.append(create("small", "", origin));
  element.append(time, kind, what, create("td", "roomy", entry.by ?? ""), create("td", "number roomy", value));
  return { element };
}

function valueInWords({ value, limit, unit }: JournalEntry): string {
  if (value === null) return "";
  const ofLimit = limit === null ? "" : ` / ${limit.toFixed(2)}`;
  return `${value.toFixed(2)}${ofLimit}\u202f${unit ?? ""}`.trim();
}

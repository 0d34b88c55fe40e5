import { create, fill, find, setAttribute, setHidden, setText } from "../dom";
import { bytes, duration, NO_VALUE } from "../format";
import type { Model } from "../live/model";
import { showHints } from "../shell/hints";
import type { KeyAction } from "../shell/keys";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import { tissueStyles } from "../tissues";
import type { RecordingInfo, Recordings } from "../wire";
import "../styles/pages.css";
import { BinSection } from "./bin";
import { deleteButton } from "./delete";
import { Polled } from "./polled";
import markup from "./recordings.html?raw";
import { dateTime, headCell, moment, Rows, type Row } from "./rows";

const EVERY_MS = 10_000;
const WHILE_READING_MS = 2000;

type Column = "name" | "recorded_at" | "duration_s" | "size_bytes";

/** Lists the recordings folder: find, replay, download or delete a recording. */
export class RecordingsPage implements Page {
  readonly keys: KeyAction[] = [
    { key: "/", label: "/", description: "Find a recording by anything that the list shows", run: () => this.filter.focus() },
  ];
  private readonly root: HTMLElement;
  private readonly filter: HTMLInputElement;
  private readonly rows: Rows<RecordingInfo>;
  private readonly polled: Polled<Recordings>;
  private readonly bin: BinSection;
  private recordings: RecordingInfo[] = [];
  private column: Column = "recorded_at";
  private descending = true;

  constructor(
    box: HTMLElement,
    model: Model,
    person: Person,
  ) {
    this.root = fill(box, markup);
    showHints(this.root);
    this.filter = find(this.root, "recordings-filter", HTMLInputElement);
    this.filter.addEventListener("input", () => this.show());
    for (const button of this.sortButtons()) button.addEventListener("click", () => this.sortBy(button.dataset.column as Column));
    this.rows = new Rows(find(this.root, "recordings-body"), ({ name }) => name, (recording) => makeRow(recording, model, ...deleteButton(recording.name, person, (text) => this.onDeleted(text))));
    const section = find(this.root, "recordings");
    this.polled = new Polled({ path: "/api/recordings", title: "The list", section, onAnswer: (answer) => this.onAnswer(answer) });
    this.bin = new BinSection(this.root, person, () => this.polled.refresh(), (text) => this.showProblem(text));
  }

  render(): void {}

  close(): void {
    this.polled.close();
    this.bin.close();
  }

  /** Updates the lists after a deletion. `text` is the reason if it failed, else null. */
  private onDeleted(text: string | null): void {
    this.showProblem(text);
    this.polled.refresh();
    this.bin.refresh();
  }

  private showProblem(text: string | null): void {
    setText(find(this.root, "recordings-told"), text ?? "");
    setHidden(find(this.root, "recordings-told"), text === null);
  }

  private onAnswer({ folder, recordings }: Recordings): number {
    this.recordings = recordings;
    for (const place of this.root.querySelectorAll(".recordings-folder")) setText(place, folder);
    this.show();
    return recordings.some(isBeingRead) ? WHILE_READING_MS : EVERY_MS;
  }

  private show(): void {
    const words = this.filter.value.toLowerCase().replaceAll("_", " ").split(/\s+/);
    const found = this.recordings.filter((recording) => {
      const text = searchText(recording);
      return words.every((word) => text.includes(word));
    });
    this.rows.show(found.toSorted((a, b) => compare(a, b, this.column, this.descending)));
    const [none, all] = [this.recordings.length === 0, this.recordings.length];
    setText(find(this.root, "recordings-count"), found.length === all ? `${all} of ${all}` : `${found.length} of ${all}`);
    setText(find(this.root, "recordings-no-match"), `No recording has “${this.filter.value.trim()}” in its name, protocol, people, answers or what was held.`);
    setHidden(find(this.root, "recordings-empty"), !none);
    setHidden(find(this.root, "recordings-tools"), none);
    setHidden(find(this.root, "recordings-where"), none);
    setHidden(find(this.root, "recordings-box"), found.length === 0);
    setHidden(find(this.root, "recordings-no-match"), none || found.length > 0);
    for (const button of this.sortButtons()) {
      const order = button.dataset.column !== this.column ? "none" : this.descending ? "descending" : "ascending";
      if (button.parentElement) setAttribute(button.parentElement, "aria-sort", order);
    }
  }

  /** Sorts by a column; the same one again reverses the order. Names start ascending, all else descending. */
  private sortBy(column: Column): void {
    this.descending = column === this.column ? !this.descending : column !== "name";
    this.column = column;
    this.show();
  }

  private sortButtons(): HTMLButtonElement[] {
    return [...this.root.querySelectorAll<HTMLButtonElement>("button[data-column]")];
  }
}

const isBeingRead = ({ duration_s: known, problem }: RecordingInfo): boolean => known === null && problem === null;

/** Returns everything that a row shows in words, in small letters. */
const searchText = ({ name, protocol, tissue, by, subject, labels, held }: RecordingInfo): string => {
  const shown = [name, protocol, tissue, by, subject, ...labels, ...held];
  return shown.filter(Boolean).join(" ").replaceAll("_", " ").toLowerCase();
};

/** Compares two recordings by a column. Unknown values come last in both orders. */
function compare(a: RecordingInfo, b: RecordingInfo, column: Column, descending: boolean): number {
  const isTime = column === "recorded_at";
  const [first, second] = isTime ? [Date.parse(a[column]), Date.parse(b[column])] : [a[column], b[column]];
  if (first === null || second === null) return Number(first === null) - Number(second === null);
  const order =
    typeof first === "number" && typeof second === "number"
      ? first - second
      : String(first).localeCompare(String(second), "en", { numeric: true });
  return (descending ? -order : order) || a.name.localeCompare(b.name, "en", { numeric: true });
}

function makeRow({ name }: RecordingInfo, model: Model, remove: HTMLElement, question: HTMLElement): Row<RecordingInfo> {
  const element = create("tr");
  const [answers, held] = [create("td", "roomy"), create("small")];
  const address = encodeURIComponent(name);
  const link = create("a", "row-link", name);
  const [problem, small, run] = [create("small", "problem"), create("small", "narrow"), create("small")];
  const [when, length, size] = [create("td", "roomy"), create("td", "number roomy"), create("td", "number roomy")];
  const replay = create("a", "action", "Replay");
  replay.href = `/recordings/${address}`;
  replay.ariaLabel = `Replay ${name}`;
  const report = create("a", "action", "Report");
  report.href = `/api/recordings/${address}/report`;
  report.target = "_blank";
  report.rel = "noopener";
  report.ariaLabel = `Report of ${name}, opens in a new tab`;
  const download = create("a", "action", "Download");
  download.href = `/api/recordings/${address}/file`;
  download.download = name;
  download.ariaLabel = `Download ${name}`;
  const what = headCell("what");
  what.append(link, run, held, small, problem, question);
  const actions = create("td", "actions");
  const buttons = create("div");
  buttons.append(replay, report, download, remove);
  actions.append(buttons);
  element.append(what, answers, when, length, size, actions);
  const update = (recording: RecordingInfo): void => {
    setLink(link, recording.problem === null ? replay.href : null);
    setHidden(replay, recording.problem !== null);
    setHidden(report, recording.problem !== null);
    setText(problem, problemInWords(recording));
    const recorded = dateTime(recording.recorded_at);
    if (when.textContent !== recorded) when.replaceChildren(moment(recording.recorded_at, recorded));
    setText(length, lengthInWords(recording));
    setText(size, bytes(recording.size_bytes));
    setText(run, runInWords(recording));
    setText(held, recording.held.length > 0 ? `held: ${recording.held.map((each) => model.titleOf(each)).join(", ")}` : "");
    showAnswers(answers, recording.labels, model);
    const facts = [recording.problem === null ? length.textContent : null, recorded, size.textContent];
    setText(small, facts.filter(Boolean).join(" · "));
  };
  return { element, update };
}

/** Shows a tick for each grasp, in the color of its answer, and how often each answer was given. */
function showAnswers(cell: HTMLElement, labels: string[], model: Model): void {
  const key = `${labels.join()}|${model.tissues.length}`;
  if (cell.dataset.key === key) return;
  cell.dataset.key = key;
  const styles = new Map(tissueStyles(model.tissues).map((style) => [style.name, style]));
  const strip = create("span", "verdicts");
  strip.ariaHidden = "true";
  for (const label of labels) {
    const tick = create("i");
    tick.dataset.slot = styles.get(label)?.slot ?? "none";
    strip.append(tick);
  }
  const counts = new Map<string, number>();
  for (const label of labels) counts.set(label, (counts.get(label) ?? 0) + 1);
  const words = [...counts].toSorted(([, a], [, b]) => b - a).map(([label, count]) => `${model.titleOf(label)} ${count}`);
  cell.replaceChildren(strip, create("small", "", words.join(", ")));
}

/** Describes the run: protocol, tissue as entered, person. */
function runInWords(recording: RecordingInfo): string {
  const { protocol, tissue, by, subject, whole, run_id: runId } = recording;
  if (runId === null) return "";
  const words = [protocol, tissue?.replaceAll("_", " "), subject, by === null ? null : `by ${by}`];
  return [...words, whole || isBeingRead(recording) ? null : "not whole: being recorded, or cut off"].filter(Boolean).join(" · ");
}

/** Returns why a recording cannot be replayed, without the file name, which the row shows already. */
function problemInWords({ name, problem }: RecordingInfo): string {
  if (problem === null) return "";
  const why = problem.startsWith(name) ? problem.slice(name.length).replace(/^[,:]?\s*/, "") : problem;
  return `Cannot be replayed: ${why}`;
}

function lengthInWords(recording: RecordingInfo): string {
  if (recording.duration_s !== null) return duration(recording.duration_s * 1000);
  return isBeingRead(recording) ? "reading…" : NO_VALUE;
}

/** Sets or removes a link's address. Without one it is plain text, which the keyboard skips. */
function setLink(link: HTMLAnchorElement, href: string | null): void {
  if (href === null) {
    link.removeAttribute("href");
    delete link.dataset.testid;
    return;
  }
  link.dataset.testid = "recording-link";
  setAttribute(link, "href", href);
}

import { create, fill, find, setAttribute, setData, setHidden, setText } from "../dom";
import { duration, NO_VALUE } from "../format";
import { messageOf, postJson } from "../live/rest";
import { showHints } from "../shell/hints";
import { keepListsInThePage } from "../shell/keys";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import type { Studies, StudyInfo, StudyRequest, StudyRun, StudyState } from "../wire";
import "../styles/pages.css";
import { Polled } from "./polled";
import { dateTime, headCell, moment, Rows, type Row } from "./rows";
import markup from "./studies.html?raw";
import { RunningStudy } from "./running-study";

const EVERY_MS = 10_000;
const WHILE_RUNNING_MS = 1000;
const STATE: Record<StudyState, string> = { running: "running", finished: "✓ finished", stopped: "■ stopped", failed: "✕ failed" };

/** Starts, watches and stops studies of the estimator, and links to their reports. */
export class StudiesPage implements Page {
  private readonly root: HTMLElement;
  private readonly choice: HTMLSelectElement;
  private readonly grasps: HTMLInputElement;
  private readonly seed: HTMLInputElement;
  private readonly start: HTMLButtonElement;
  private readonly message: HTMLElement;
  private readonly now: RunningStudy;
  private readonly rows: Rows<StudyRun>;
  private readonly polled: Polled<Studies>;
  private available: StudyInfo[] = [];
  private startedHere: string | null = null;

  constructor(
    box: HTMLElement,
    private readonly person: Person,
  ) {
    this.root = fill(box, markup);
    keepListsInThePage(this.root);
    showHints(this.root);
    this.choice = find(this.root, "study-choice", HTMLSelectElement);
    this.grasps = find(this.root, "study-grasps", HTMLInputElement);
    this.seed = find(this.root, "study-seed", HTMLInputElement);
    this.start = find(this.root, "study-start", HTMLButtonElement);
    this.message = find(this.root, "study-message");
    this.choice.addEventListener("change", () => this.describe());
    find(this.root, "study-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.submit();
    });
    this.now = new RunningStudy(this.root, person, () => this.polled.refresh());
    this.rows = new Rows(find(this.root, "studies-body"), ({ id }) => id, makeRow);
    const section = find(this.root, "studies");
    this.polled = new Polled({ path: "/api/studies", title: "The list", section, onAnswer: (answer) => this.onAnswer(answer) });
  }

  render(): void {
    this.now.render();
  }

  close(): void {
    this.polled.close();
  }

  private onAnswer({ folder, available, runs }: Studies): number {
    if (JSON.stringify(available) !== JSON.stringify(this.available)) this.list(available);
    const running = runs.find(({ state }) => state === "running") ?? null;
    const earlier = runs.filter(({ state }) => state !== "running");
    this.now.show(running);
    this.rows.show(earlier);
    setHidden(find(this.root, "studies-box"), earlier.length === 0);
    setHidden(find(this.root, "studies-empty"), earlier.length > 0);
    setText(find(this.root, "studies-folder"), folder);
    const ended = earlier.find(({ id }) => id === this.startedHere);
    if (ended) {
      this.startedHere = null;
      this.showMessage(`Study ${ended.study} ${ended.state} after ${timeTaken(ended)}.`, ended.state === "failed" ? "failed" : "done");
    }
    return running ? WHILE_RUNNING_MS : EVERY_MS;
  }

  private list(available: StudyInfo[]): void {
    this.available = available;
    const chosen = this.choice.value;
    for (const old of Array.from(this.choice.options)) old.remove();
    this.choice.append(...available.map(option));
    if (available.some(({ name }) => name === chosen)) this.choice.value = chosen;
    this.choice.disabled = this.start.disabled = available.length === 0;
    this.describe();
  }

  private describe(): void {
    const study = this.available.find(({ name }) => name === this.choice.value);
    if (!study) return;
    setText(find(this.root, "study-about"), study.title);
    this.grasps.value = study.grasps === null ? "" : String(study.grasps);
    this.grasps.max = String(study.most_grasps);
    setText(find(this.root, "study-most"), `At most ${study.most_grasps.toLocaleString("en")} of each.`);
  }

  private async submit(): Promise<void> {
    if (this.start.ariaBusy === "true") return;
    this.showMessage("Starting…", "pending");
    setAttribute(this.start, "aria-busy", "true");
    try {
      const run = await postJson<StudyRun>("/api/studies", this.request());
      this.startedHere = run.id;
      this.showMessage(`Started: ${run.study}, ${run.grasps} of each, seed ${run.seed}.`, "done");
    } catch (error) {
      this.showMessage(`Not started: ${messageOf(error)}`, "failed");
    } finally {
      setAttribute(this.start, "aria-busy", "false");
    }
    this.polled.refresh();
  }

  private request(): StudyRequest {
    const grasps = this.grasps.value.trim();
    return {
      study: this.choice.value,
      grasps: grasps === "" ? null : Number(grasps),
      seed: Number(this.seed.value),
      by: this.person.name,
    };
  }

  private showMessage(text: string, outcome: "pending" | "done" | "failed"): void {
    setText(this.message, text);
    setData(this.message, "outcome", outcome);
  }
}

function option({ name, title }: StudyInfo): HTMLOptionElement {
  const element = create("option");
  element.value = name;
  element.append(create("strong", "", name), create("span", "", `: ${title}`));
  return element;
}

const timeTaken = ({ started_at: from, ended_at: to }: StudyRun): string =>
  to === null ? NO_VALUE : duration(Date.parse(to) - Date.parse(from));

/** Creates the row of a finished study, which does not change any more. */
function makeRow(run: StudyRun): Row<StudyRun> {
  const element = create("tr");
  const [what, when, state] = [headCell("what"), create("td", "roomy"), create("td", "study-state", STATE[run.state])];
  what.append(run.study, create("small", "narrow", factsOf(run)));
  when.append(moment(run.started_at, dateTime(run.started_at)));
  if (run.why !== null) state.append(create("small", "problem", run.why));
  const report = create("td", "actions", run.report === null ? NO_VALUE : "");
  if (run.report !== null) {
    const link = create("a", "action", "Report");
    link.href = run.report;
    link.target = "_blank";
    link.rel = "noopener";
    link.ariaLabel = `Report of ${run.study}, ${dateTime(run.started_at)}, in a new tab`;
    report.append(link);
  }
  element.append(
    when,
    what,
    create("td", "roomy", run.by ?? NO_VALUE),
    create("td", "number roomy", String(run.grasps)),
    create("td", "number roomy", String(run.seed)),
    state,
    create("td", "number roomy", timeTaken(run)),
    report,
  );
  return { element };
}

const factsOf = (run: StudyRun): string =>
  [dateTime(run.started_at), run.by, `${run.grasps} of each`, `seed ${run.seed}`, timeTaken(run)].filter(Boolean).join(" · ");

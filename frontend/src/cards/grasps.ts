import { create, find, setHidden, setText } from "../dom";
import { NO_VALUE, newtons, percent, shortTime, wholePercent } from "../format";
import type { Model } from "../live/model";
import { tissueStyles, UNKNOWN_SLOT } from "../tissues";
import type { GraspEnded, GraspTruth, Priority } from "../wire";
import type { CorrectionForm } from "./correction";

/** Lists the grasps of this run, newest first. */
export class GraspsTable {
  private shown: GraspEnded[] | null = null;
  private truthsShown: ReadonlyMap<number, GraspTruth> | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
    private readonly correction: CorrectionForm,
  ) {}

  render(): void {
    const { grasps, truths } = this.model;
    setHidden(find(this.root, "grasps"), grasps.length === 0);
    setText(find(this.root, "grasps-empty"), this.note());
    this.renderLink();
    if (grasps === this.shown && truths === this.truthsShown) return;
    [this.shown, this.truthsShown] = [grasps, truths];
    find(this.root, "grasps-body").replaceChildren(...grasps.map((ended) => this.row(ended)));
  }

  /** Links to all figures of the run's grasps, in the form that programs get from the API. */
  private renderLink(): void {
    const run = this.model.graspsOfRun;
    const box = find(this.root, "grasps-links");
    setHidden(box, run === null || this.model.grasps.length === 0);
    if (run === null || box.dataset.run === run) return;
    box.dataset.run = run;
    const link = create("a", "", "All figures of this run (JSON)");
    link.href = `/api/runs/${encodeURIComponent(run)}/grasps`;
    link.download = `${run}.json`;
    box.replaceChildren(link);
  }

  private note(): string {
    const { grasps, state } = this.model;
    const run = state?.run ?? state?.last_run;
    const missing = (run?.grasps ?? 0) - grasps.filter((ended) => ended.run_id !== null).length;
    if (missing > 0 && grasps.length > 0) return `${missing} earlier of ${run?.grasps} are not shown here.`;
    if (missing > 0) return `${missing} came before this page was opened and are not shown here.`;
    return grasps.length > 0 ? "" : "None yet. Each grasp gets a line here when the jaws have opened again.";
  }

  private row({ grasp, run_id: runId }: GraspEnded): HTMLTableRowElement {
    const row = create("tr");
    const { alarms, held_back: heldBack } = grasp;
    const share = grasp.peak_share_of_limit === null ? NO_VALUE : wholePercent(grasp.peak_share_of_limit);
    const tissue = create("td", "what");
    const style = tissueStyles(this.model.tissues).find(({ name }) => name === grasp.label);
    const swatch = create("span", "swatch", style?.mark ?? "…");
    tissue.dataset.slot = style?.slot ?? UNKNOWN_SLOT;
    tissue.append(swatch, this.model.titleOf(grasp.label));
    if (!grasp.valid) tissue.append(create("small", "invalid", `not valid: ${grasp.why_invalid ?? "no reason given"}`));
    row.append(
      create("td", "", runId === null && this.model.graspsOfRun !== null ? NO_VALUE : String(grasp.index)),
      tissue,
      this.held(grasp.index, runId),
      create("td", "", percent(grasp.probability)),
      create("td", "roomy", shortTime(grasp.time_to_decision_s)),
      create("td", "", newtons(grasp.peak_force_n)),
      create("td", "", share),
      this.alarms(alarms, heldBack),
    );
    return row;
  }

  /** What a person said that was held, with a button that corrects it. */
  private held(grasp: number, runId: string | null): HTMLTableCellElement {
    const cell = create("td", "held");
    const truth = this.model.truths.get(grasp);
    const words = [truth?.held ? this.model.titleOf(truth.held) : "", truth?.place ?? "", truth?.remark ?? ""].filter(Boolean).join(", ");
    const isOfRun = this.model.isReplay || runId !== null;
    if (!isOfRun || !this.correction.isAllowed) {
      cell.textContent = words || NO_VALUE;
      return cell;
    }
    const button = create("button", "", words || "say");
    button.type = "button";
    button.ariaLabel = `What was held in grasp ${grasp}: ${words || "not stated"}. Correct it`;
    button.dataset.testid = `truth-of-${grasp}`;
    button.addEventListener("click", () => this.correction.open(grasp));
    cell.append(button);
    return cell;
  }

  /** Counts the alarms of each priority, in words, so that color is not needed. */
  private alarms(alarms: Priority[], heldBack: boolean): HTMLTableCellElement {
    const cell = create("td", "alarms");
    for (const priority of ["high", "medium", "low"] as const) {
      const times = alarms.filter((alarm) => alarm === priority).length;
      if (times === 0) continue;
      const mark = create("span", "alarm-count", times === 1 ? priority : `${times} ${priority}`);
      mark.dataset.priority = priority;
      cell.append(mark);
    }
    if (heldBack) cell.append(create("span", "held-back", "held back"));
    if (cell.childElementCount === 0) cell.textContent = NO_VALUE;
    return cell;
  }
}

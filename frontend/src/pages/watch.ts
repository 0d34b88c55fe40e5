import { AgeLabels } from "../cards/age-labels";
import { CorrectionForm } from "../cards/correction";
import { CriteriaTable } from "../cards/criteria";
import { ForceCard } from "../cards/force";
import { GraspsTable } from "../cards/grasps";
import { LabSessionLine } from "../cards/lab-session";
import { ProtocolPanel } from "../cards/protocol";
import { StressCard } from "../cards/stress";
import { TissueCard } from "../cards/tissue";
import { TruthCard } from "../cards/truth";
import { ChartStack } from "../charts/stack";
import { fill, setData } from "../dom";
import type { Model } from "../live/model";
import { showHints } from "../shell/hints";
import { keepListsInThePage, type KeyAction } from "../shell/keys";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import type { ViewChoice } from "../shell/view-choice";
import "../styles/watch.css";
import "../styles/cards.css";
import "../styles/charts.css";
import "../styles/or-view.css";
import markup from "./watch.html?raw";

/** Longest time that the page stays empty while it waits for the tool's and the library's names. */
const MAX_EMPTY_MS = 2_000;

/** The cards and charts of one source: the live tool or a recording. */
export class WatchPage implements Page {
  readonly root: HTMLElement;
  readonly charts: ChartStack;
  private readonly tissue: TissueCard;
  private readonly force: ForceCard;
  private readonly stress: StressCard;
  private readonly criteria: CriteriaTable;
  private readonly grasps: GraspsTable;
  private readonly protocol: ProtocolPanel;
  private readonly truth: TruthCard;
  private readonly labSession: LabSessionLine;
  private readonly ages: AgeLabels;
  private readonly openedAt = performance.now();

  /** `view` chooses between the two views of the live page; a replay has the detailed one only. */
  constructor(
    box: HTMLElement,
    private readonly model: Model,
    person: Person,
    private readonly view: ViewChoice | null = null,
  ) {
    const root = fill(box, markup);
    this.root = root;
    keepListsInThePage(root);
    showHints(root);
    this.ages = new AgeLabels(root, model);
    this.tissue = new TissueCard(root, model);
    this.force = new ForceCard(root, model);
    this.charts = new ChartStack(root, model);
    this.stress = new StressCard(root, model);
    this.criteria = new CriteriaTable(root, model);
    this.grasps = new GraspsTable(root, model, new CorrectionForm(root, model, person));
    this.truth = new TruthCard(root, model, person);
    this.labSession = new LabSessionLine(root, model, person);
    this.protocol = new ProtocolPanel(root, model, person);
    if (!model.isReplay) void this.protocol.load();
    this.view?.open();
  }

  /** The tissues' keys change with the library. */
  get keys(): KeyAction[] {
    const views = this.view ? [viewKey(this.view)] : [];
    if (this.view?.isOr) return views;
    const live = this.model.isReplay ? [] : [startKey(this.protocol), spotKey(this.protocol), ...this.truth.keys];
    return [...views, ...chartKeys(this.charts), ...live];
  }

  render(nowMs: number): void {
    setData(this.root, "ready", String(this.model.hello !== null || nowMs - this.openedAt > MAX_EMPTY_MS));
    this.ages.render(nowMs);
    this.tissue.render(nowMs);
    this.force.render();
    if (this.view?.isOr) return;
    this.protocol.render();
    this.truth.render();
    this.labSession.render();
    this.grasps.render();
    this.criteria.render();
    this.stress.render(nowMs);
    this.charts.render();
  }

  connected(): void {
    void this.protocol.load();
  }

  /** Clears the message about the last start. */
  stopped(): void {
    this.protocol.forget();
  }

  themeChanged(): void {
    this.charts.rebuild();
    this.stress.rebuild();
  }

  close(): void {
    this.view?.close();
    this.charts.close();
    this.stress.close();
  }
}

const viewKey = (view: ViewChoice): KeyAction => ({
  key: "v",
  label: "V",
  description: "OR view, or all details",
  run: () => view.toggle(),
});

const startKey = (protocol: ProtocolPanel): KeyAction => ({
  key: "S",
  label: "Shift + S",
  description: "Start the chosen protocol",
  run: () => protocol.submitByKey(),
});

const spotKey = (protocol: ProtocolPanel): KeyAction => ({
  key: "n",
  label: "N",
  description: "Begin a new spot; a grasp under way belongs to the spot before",
  run: () => void protocol.beginSpot(),
});

const chartKeys = (charts: ChartStack): KeyAction[] => [
  { key: "p", label: "P", description: "Pause the charts, or go on", run: () => charts.togglePause() },
  { key: "ArrowLeft", label: "←", description: "Look back", run: () => charts.move(-0.25) },
  { key: "ArrowRight", label: "→", description: "Look forward", run: () => charts.move(0.25) },
  { key: "+", label: "+", description: "Zoom in", run: () => charts.zoom(0.5) },
  { key: "-", label: "−", description: "Zoom out", run: () => charts.zoom(2) },
  { key: "r", label: "R", description: "Charts: reset, follow the tool", run: () => charts.reset() },
  { key: "a", label: "A", description: "Chart of alpha", run: () => charts.showParameter("alpha_n") },
  { key: "b", label: "B", description: "Chart of beta", run: () => charts.showParameter("beta_per_m") },
  { key: "d", label: "D", description: "Chart of d", run: () => charts.showParameter("damping_kg_per_s") },
  { key: "f", label: "F", description: "Chart of each filter's fit (NIS)", run: () => charts.showParameter("nis") },
  { key: "g", label: "G", description: "Chart of each filter's force", run: () => charts.showParameter("force_n") },
];

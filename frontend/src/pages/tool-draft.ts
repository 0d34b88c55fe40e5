import { create, createOption, createSvg, find, setAttribute, setData, setHidden, setText } from "../dom";
import { messageOf, postFile } from "../live/rest";
import type { ColumnSummary, GraspSummary, ToolDraftReport } from "../wire";
import { headCell } from "./rows";

const PATH = "/api/configuration/tool/draft";
const DIGITS = 4;
const PLOT_WIDTH = 120;
const PLOT_HEIGHT = 20;

/** The form that makes a tool file from a recording: shows its columns, asks what is what, shows the first grasps. */
export class ToolDraftForm {
  private recording: File | null = null;
  private latest = 0;

  constructor(
    private readonly root: HTMLElement,
    /** Opens the text of a new tool file in the editor. */
    private readonly edit: (name: string, text: string) => void,
  ) {}

  /** Reads each recording that is chosen, and makes the tool file once its columns are named. */
  listen(): void {
    const input = find(this.root, "draft-file", HTMLInputElement);
    input.addEventListener("change", () => void this.survey(input.files?.[0] ?? null));
    find(this.root, "draft-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.make();
    });
  }

  private async survey(recording: File | null): Promise<void> {
    this.recording = recording;
    setHidden(find(this.root, "draft-questions"), true);
    this.showGrasps([]);
    if (!recording) return this.showMessage("", "done");
    const attempt = ++this.latest;
    await this.attempt("Not read", async () => {
      this.showMessage("Reading the recording…", "pending");
      const { columns, times } = await this.ask(recording, new URLSearchParams());
      if (attempt !== this.latest) return;
      find(this.root, "draft-columns-body").replaceChildren(...columns.map(columnRow));
      for (const id of ["draft-force", "draft-position"]) this.offer(id, columns, "Choose a column");
      this.offer("draft-command", columns, "None: the tool is closed by hand");
      setText(find(this.root, "draft-times"), times ? `Column ${times.column} holds the times, in ${times.unit}: ${short(times.rate_hz)} samples a second.` : "No column looks like times.");
      setHidden(find(this.root, "draft-rate-field"), times !== null);
      setHidden(find(this.root, "draft-questions"), false);
      this.showMessage(`${columns.length} columns. Say what they are.`, "done");
    });
  }

  private async make(): Promise<void> {
    const recording = this.recording;
    const button = find(this.root, "draft-make", HTMLButtonElement);
    if (!recording || button.ariaBusy === "true") return;
    const attempt = ++this.latest;
    setAttribute(button, "aria-busy", "true");
    await this.attempt("No tool file", async () => {
      const answers = new URLSearchParams({ name: this.value("draft-name") });
      for (const key of ["force", "position", "command", "newton", "millimetre", "port"]) {
        const value = this.value(`draft-${key}`);
        if (value !== "") answers.set(key, value);
      }
      if (!answers.has("force") || !answers.has("position")) throw new Error("choose the columns of force and position");
      answers.set("rate_hz", this.value("draft-rate") || "1000");
      this.showMessage("Making the tool file, and looking for grasps…", "pending");
      const { text, assumed, grasps, first_grasps: first } = await this.ask(recording, answers);
      if (attempt !== this.latest) return;
      this.showGrasps(first);
      const found = grasps === 0 ? "No grasp was found: look at closing_deg, or at the motor command's column." : `${grasps} grasps were found.`;
      const guessed = assumed.length ? ` Assumed: the ${assumed.join(" and the ")}.` : "";
      this.showMessage(`${found}${guessed} The file is in the editor below: check it, then save it.`, "done");
      this.edit(this.value("draft-name"), text ?? "");
    });
    setAttribute(button, "aria-busy", "false");
  }

  private ask(recording: File, answers: URLSearchParams): Promise<ToolDraftReport> {
    answers.set("file", recording.name);
    return postFile(`${PATH}?${answers.toString()}`, recording);
  }

  private value(id: string): string {
    const field = this.root.querySelector<HTMLInputElement | HTMLSelectElement>(`#${id}`);
    return field?.value.trim() ?? "";
  }

  private offer(id: string, columns: ColumnSummary[], none: string): void {
    const options = columns.map((column) => createOption(String(column.number), titleOf(column)));
    find(this.root, id, HTMLSelectElement).replaceChildren(createOption("", none), ...options);
  }

  private showGrasps(grasps: GraspSummary[]): void {
    setHidden(find(this.root, "draft-grasps"), grasps.length === 0);
    const rows = grasps.map((grasp) => {
      const row = create("tr");
      const head = headCell("what");
      head.textContent = String(grasp.number);
      const figures = [grasp.start_s, grasp.duration_s, grasp.peak_force_n, grasp.travel_m * 1000];
      row.append(head, ...figures.map((value) => create("td", "number", value.toFixed(2))), create("td", "", grasp.has_contact ? "yes" : "no"));
      return row;
    });
    find(this.root, "draft-grasps-body").replaceChildren(...rows);
  }

  private async attempt(failure: string, act: () => Promise<void>): Promise<void> {
    try {
      await act();
    } catch (error) {
      this.showMessage(`${failure}: ${messageOf(error)}`, "failed");
    }
  }

  private showMessage(text: string, outcome: "pending" | "done" | "failed"): void {
    const message = find(this.root, "draft-message");
    setData(message, "outcome", outcome);
    setText(message, text);
  }
}

const short = (value: number): string => String(Number(value.toPrecision(DIGITS)));

const titleOf = ({ number, name }: ColumnSummary): string => (name ? `${number}: ${name}` : String(number));

function columnRow(column: ColumnSummary): HTMLTableRowElement {
  const row = create("tr");
  const head = headCell("what");
  head.textContent = titleOf(column);
  const plot = create("td");
  plot.append(sparkline(column));
  row.append(head, create("td", "number", short(column.low)), create("td", "number", short(column.high)), plot);
  return row;
}

function sparkline({ means }: ColumnSummary): SVGElement {
  const low = Math.min(...means);
  const span = Math.max(...means) - low || 1;
  const points = means.map((mean, i) => `${((i / Math.max(means.length - 1, 1)) * PLOT_WIDTH).toFixed(1)},${(PLOT_HEIGHT - 1 - ((mean - low) / span) * (PLOT_HEIGHT - 2)).toFixed(1)}`);
  const svg = createSvg("svg", { viewBox: `0 0 ${PLOT_WIDTH} ${PLOT_HEIGHT}`, class: "sparkline", "aria-hidden": "true" });
  svg.append(createSvg("polyline", { points: points.join(" ") }));
  return svg;
}

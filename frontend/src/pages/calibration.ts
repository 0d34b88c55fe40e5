import { create, fill, find, setAttribute, setHidden, setText } from "../dom";
import { NO_VALUE } from "../format";
import { deletePath, messageOf, postJson, takeReading, useToolFile } from "../live/rest";
import { showHints } from "../shell/hints";
import type { Person } from "../shell/person";
import type { Page } from "../shell/router";
import type { Calibration, CalibrationKind, CalibrationRequest, CalibrationResult } from "../wire";
import "../styles/pages.css";
import { plot } from "./fit-plot";
import { Polled } from "./polled";
import markup from "./calibration.html?raw";

const PATH = "/api/calibration";
const EVERY_MS = 3000;
const WHILE_READING_MS = 500;
const DIGITS = 5;
const PERCENT = 100;

interface Procedure {
  /** The list of values to ask for; none if there is a single reading. */
  values?: { name: string; usual: string; unit: string };
  moves: boolean;
  instruction: (value: number) => string;
}

const PROCEDURES: Record<CalibrationKind, Procedure> = {
  tare: {
    moves: false,
    instruction: () => "Leave the jaws open and empty, and let nothing pull on the tool. It is read for ten seconds.",
  },
  strain: {
    values: { name: "Pulls on the handle in their order, N", usual: "0, 2, 4, 6, 8, 10, 5, 0", unit: "N" },
    moves: false,
    instruction: (value) => (value ? `Hang a pull of ${value} N on the handle, and let it come to rest.` : "Hang nothing on the handle."),
  },
  force: {
    values: { name: "Forces on a load cell between the jaws in their order, N", usual: "0, 1, 2, 3, 4, 5, 3, 1", unit: "N" },
    moves: false,
    instruction: (value) =>
      value
        ? `Pull the handle until the load cell between the jaws shows ${value} N, and hold it there.`
        : "Leave the jaws open, with nothing between them, and let nothing pull on the handle.",
  },
  stretch: { moves: true, instruction: () => "Empty the jaws. They close with half a volt for a quarter of a minute: let nobody be near." },
  geometry: {
    values: { name: "Gauges between the jaws, mm", usual: "0, 2, 4, 6, 8", unit: "mm" },
    moves: true,
    instruction: (value) =>
      `${value ? `Put the gauge of ${value} mm between the jaws.` : "Leave the jaws empty."} They close with half a volt: let nobody be near.`,
  },
};

/** Guides through a calibration of the tool: instructions, readings, the fit, and the file it was written to. */
export class CalibrationPage implements Page {
  private readonly root: HTMLElement;
  private readonly what: HTMLSelectElement;
  private readonly values: HTMLInputElement;
  private readonly readButton: HTMLButtonElement;
  private readonly polled: Polled<Calibration>;
  private shownState = "";

  constructor(
    box: HTMLElement,
    private readonly person: Person,
  ) {
    this.root = fill(box, markup);
    showHints(this.root);
    this.what = find(this.root, "calibrate-what", HTMLSelectElement);
    this.values = find(this.root, "calibrate-values", HTMLInputElement);
    this.readButton = find(this.root, "reading-take", HTMLButtonElement);
    find(this.root, "calibrate-person", HTMLInputElement).value = this.person.name ?? "";
    this.what.addEventListener("change", () => this.describe());
    this.describe();
    find(this.root, "calibrate-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.begin();
    });
    this.readButton.addEventListener("click", () => void this.sendReading());
    find(this.root, "reading-abandon").addEventListener("click", () => void this.abandon());
    find(this.root, "fit-use").addEventListener("click", () => void this.use());
    const section = find(this.root, "calibration");
    this.polled = new Polled({ path: PATH, title: "The calibration", section, onAnswer: (answer) => this.show(answer) });
  }

  render(): void {}

  close(): void {
    this.polled.close();
  }

  private describe(): void {
    const { values } = PROCEDURES[this.what.value as CalibrationKind];
    setHidden(find(this.root, "calibrate-values-field"), !values);
    setHidden(find(this.root, "calibrate-load-cell-field"), this.what.value !== "force");
    if (!values) return;
    setText(find(this.root, "calibrate-values-name"), values.name);
    this.values.value = values.usual;
  }

  private async begin(): Promise<void> {
    const what = this.what.value as CalibrationKind;
    const numbers = PROCEDURES[what].values ? this.values.value.split(/[\s,;]+/).filter(Boolean).map(Number) : [];
    if (numbers.some(Number.isNaN)) {
      this.showMessage("Not begun: write numbers with commas between.", "failed");
      return;
    }
    const person = find(this.root, "calibrate-person", HTMLInputElement).value.trim();
    const days = Number(find(this.root, "calibrate-days", HTMLInputElement).value);
    const loadCellError = Number(find(this.root, "calibrate-load-cell-error", HTMLInputElement).value) / PERCENT;
    const request: CalibrationRequest = { what, values: numbers, person: person || null, valid_days: days, load_cell_error: loadCellError };
    try {
      this.show(await postJson<Calibration>(PATH, request));
      this.showMessage("Begun: do what stands beside, then take the reading.", "done");
    } catch (error) {
      this.showMessage(`Not begun: ${messageOf(error)}`, "failed");
    }
  }

  private async sendReading(): Promise<void> {
    if (this.readButton.ariaBusy === "true") return;
    setAttribute(this.readButton, "aria-busy", "true");
    setText(find(this.root, "reading-problem"), "");
    this.showMessage("", "done");
    try {
      this.show(await takeReading<Calibration>());
    } catch (error) {
      setText(find(this.root, "reading-problem"), messageOf(error));
    } finally {
      setAttribute(this.readButton, "aria-busy", "false");
    }
    this.polled.refresh();
  }

  private async abandon(): Promise<void> {
    try {
      await deletePath(PATH);
    } catch (error) {
      setText(find(this.root, "reading-problem"), messageOf(error));
    }
    this.polled.refresh();
  }

  /** Makes the tool go on with the new constants. */
  private async use(): Promise<void> {
    const name = find(this.root, "fit-file").textContent.replace(/^.*[/\\]|\.toml$/g, "");
    const message = find(this.root, "fit-use-message");
    try {
      await useToolFile(name, this.person.name);
      setText(message, `${name} is used from now on. The tool is ready again in some seconds, disarmed.`);
    } catch (error) {
      setText(message, `Not used: ${messageOf(error)}`);
    }
  }

  private show(state: Calibration): number {
    const nextRequestMs = state.reading ? WHILE_READING_MS : EVERY_MS;
    const newState = JSON.stringify(state);
    if (newState === this.shownState) return nextRequestMs;
    this.shownState = newState;
    const { what, values, readings, reading, problem, result } = state;
    setHidden(find(this.root, "reading-none"), what !== null);
    setHidden(find(this.root, "reading-box"), what === null);
    setHidden(find(this.root, "fit-card"), result === null);
    if (what === null) return nextRequestMs;
    const procedure = PROCEDURES[what];
    const next = values[readings.length];
    const hasNext = next !== undefined;
    const number = values.length > 1 ? `${readings.length + 1} of ${values.length}: ` : "";
    setText(find(this.root, "reading-do"), hasNext ? number + procedure.instruction(next) : result ? "All is read, and written." : "All is read. Begin again.");
    setHidden(this.readButton, !hasNext);
    setHidden(find(this.root, "reading-abandon"), result !== null);
    setText(this.readButton, reading ? "Reading…" : procedure.moves ? "Close the jaws and read" : "Read");
    setText(find(this.root, "reading-problem"), problem ?? "");
    setHidden(find(this.root, "reading-table"), readings.length === 0);
    setText(find(this.root, "reading-value-name"), procedure.values ? procedure.values.unit : "Reading");
    find(this.root, "reading-body").replaceChildren(
      ...readings.map(({ value, strain_v, encoder_deg }, n) =>
        row(procedure.values ? String(value) : String(n + 1), strain_v.toFixed(4), encoder_deg.toFixed(1)),
      ),
    );
    if (result) showResult(this.root, result);
    return nextRequestMs;
  }

  private showMessage(text: string, outcome: "done" | "failed"): void {
    const message = find(this.root, "calibrate-message");
    message.dataset.outcome = outcome;
    setText(message, text);
  }
}

function showResult(root: HTMLElement, { constants, remarks, file, ...points }: CalibrationResult): void {
  find(root, "fit-body").replaceChildren(
    ...constants.map((each) =>
      row(
        each.key,
        each.before === null ? NO_VALUE : digits(each.before),
        `${digits(each.value)} ${each.unit}`,
        `${digits(each.low)} to ${digits(each.high)}`,
        `${each.residual.toPrecision(2)} ${each.residual_unit}`,
      ),
    ),
  );
  setText(find(root, "fit-remarks"), remarks.join(" "));
  setText(find(root, "fit-file"), file);
  plot(find(root, "fit-plot", SVGSVGElement), points);
}

const digits = (value: number): string => Number(value.toPrecision(DIGITS)).toString();

function row(first: string, ...others: string[]): HTMLTableRowElement {
  const line = create("tr");
  line.append(create("th", "", first), ...others.map((text) => create("td", "number", text)));
  return line;
}

import { create, fill, find, setData } from "../dom";
import { bytes, duration } from "../format";
import { serverTimeMs } from "../live/clock";
import { showHints } from "../shell/hints";
import type { Page } from "../shell/router";
import type { ConstantInfo, System } from "../wire";
import "../styles/pages.css";
import { configuration } from "./configuration";
import { showFacts } from "./facts";
import { Journal } from "./journal";
import { Polled } from "./polled";
import { dateTime, headCell } from "./rows";
import markup from "./system.html?raw";

const EVERY_MS = 5000;

/** Shows the running service, the tool's calibration and configuration, and the journal. */
export class SystemPage implements Page {
  private readonly root: HTMLElement;
  private readonly polled: Polled<System>;
  private readonly journal: Journal;
  private configured = "";

  constructor(box: HTMLElement) {
    this.root = fill(box, markup);
    showHints(this.root);
    const section = find(this.root, "system");
    this.polled = new Polled({ path: "/api/system", title: "The system", section, onAnswer: (system) => this.onAnswer(system) });
    this.journal = new Journal(this.root);
  }

  render(): void {}

  close(): void {
    this.polled.close();
    this.journal.close();
  }

  private onAnswer(system: System): number {
    showFacts(find(this.root, "service-facts"), {
      Machine: system.machine,
      "Up for": duration(serverTimeMs() - Date.parse(system.started_at)),
      Started: dateTime(system.started_at),
      "Data folder": system.data_folder,
      "Free disk": system.free_disk_bytes === null ? "the folder is gone" : bytes(system.free_disk_bytes),
    });
    showFacts(find(this.root, "service-workers"), nameWorkers(system.workers));
    for (const dd of find(this.root, "service-workers").querySelectorAll("dd")) setData(dd, "warn", String(dd.textContent === "faulted"));
    showFacts(find(this.root, "service-realtime"), nameWorkers(system.realtime));
    showFacts(find(this.root, "service-versions"), system.versions);
    showCalibration(this.root, system);
    this.showConfiguration(system);
    return EVERY_MS;
  }

  /** Shows the configuration. If it is unchanged, sections that the person opened stay open. */
  private showConfiguration({ tool, settings }: System): void {
    const configured = JSON.stringify([tool, settings]);
    if (configured === this.configured) return;
    this.configured = configured;
    find(this.root, "configuration-tool").replaceChildren(...configuration(tool));
    find(this.root, "configuration-settings").replaceChildren(...configuration(settings));
  }
}

/** Returns what is known of each worker by its name for people; "guard" is the safety monitor's key in the REST interface. */
function nameWorkers(facts: Record<string, string>): Record<string, string> {
  return Object.fromEntries(Object.entries(facts).map(([key, value]) => [key === "guard" ? "safety monitor" : key, value]));
}

function showCalibration(root: HTMLElement, { tool, force_scale: scale, constants }: System): void {
  showFacts(find(root, "calibration-facts"), { Tool: String(tool.title), Forces: scale.text, "Scale from": scale.source });
  find(root, "calibration-constants").replaceChildren(...constants.map(constantRow));
}

function constantRow({ constant, value, date, by, expires, expired }: ConstantInfo): HTMLTableRowElement {
  const row = create("tr");
  const name = headCell();
  name.append(create("code", "", constant));
  const until = create("td", "", expired ? `expired ${expires}` : (expires ?? "not said"));
  setData(until, "warn", String(expired));
  row.append(name, create("td", "number", String(Number(value.toPrecision(6)))), create("td", "", date), create("td", "roomy", by), until);
  return row;
}

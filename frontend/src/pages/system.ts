import { byId, fill, setData, setText } from "../dom";
import { bytes, count, duration, NO_VALUE } from "../format";
import { showHints } from "../shell/hints";
import type { Page } from "../shell/router";
import type { System } from "../wire";
import "../styles/pages.css";
import { configuration } from "./configuration";
import { showFacts } from "./facts";
import { Journal } from "./journal";
import { Polled } from "./polled";
import { dateTime } from "./rows";
import markup from "./system.html?raw";

const EVERY_MS = 5000;
const DAY_MS = 86_400_000;

/** What runs here, how the tool is calibrated and set up, and what happened. */
export class SystemPage implements Page {
  private readonly polled: Polled<System>;
  private readonly journal: Journal;
  private configured = "";

  constructor(box: HTMLElement) {
    fill(box, markup);
    showHints(box);
    const section = byId("system");
    this.polled = new Polled({ path: "/api/system", what: "The system", section, take: (system) => this.take(system) });
    this.journal = new Journal();
  }

  render(): void {}

  close(): void {
    this.polled.close();
    this.journal.close();
  }

  private take(system: System): number {
    showFacts(byId("service-facts"), {
      Machine: system.machine,
      "Up for": duration(Date.now() - Date.parse(system.started_at)),
      Started: dateTime(system.started_at),
      "Data folder": system.data_folder,
      "Free disk": system.free_disk_bytes === null ? "the folder is gone" : bytes(system.free_disk_bytes),
    });
    showFacts(byId("service-workers"), system.workers);
    for (const dd of byId("service-workers").querySelectorAll("dd")) setData(dd, "warn", String(dd.textContent === "faulted"));
    showFacts(byId("service-realtime"), system.realtime);
    showFacts(byId("service-versions"), system.versions);
    showCalibration(system.tool);
    this.showConfiguration(system);
    return EVERY_MS;
  }

  /** Only when it is another one: what somebody has opened stays open. */
  private showConfiguration({ tool, settings }: System): void {
    const configured = JSON.stringify([tool, settings]);
    if (configured === this.configured) return;
    this.configured = configured;
    byId("configuration-tool").replaceChildren(...configuration(tool));
    byId("configuration-settings").replaceChildren(...configuration(settings));
  }
}

function showCalibration({ title, calibration }: System["tool"]): void {
  const { date, person, expires } = (calibration ?? {}) as { date?: string; person?: string; expires?: string | null };
  setText(byId("calibration-age"), ageInWords(date));
  showFacts(byId("calibration-facts"), {
    Calibrated: date ?? NO_VALUE,
    By: person ?? NO_VALUE,
    "Good until": expires ?? "not said",
    Tool: String(title),
  });
}

function ageInWords(date: string | undefined): string {
  const days = Math.floor((Date.now() - Date.parse(`${date}T00:00`)) / DAY_MS);
  if (Number.isNaN(days)) return "Age not known";
  if (days < 0) return "Dated in the future";
  return days === 0 ? "Today" : `${count(days, "day")} old`;
}

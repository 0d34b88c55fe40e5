import { create } from "../dom";
import { headCell } from "./rows";

type Values = Record<string, unknown>;

/** Shows a configuration: single values in a table, each nested table in a section that opens. */
export function configuration(values: Values): HTMLElement[] {
  const entries = Object.entries(values);
  const single = entries.filter(([, value]) => !isTable(value));
  const tables = entries.flatMap(([key, value]) => (isTable(value) ? [section(key, value)] : []));
  return single.length === 0 ? tables : [tableOf(single), ...tables];
}

function section(key: string, values: Values): HTMLDetailsElement {
  const details = create("details");
  const summary = create("summary");
  summary.append(create("code", "", `[${key}]`));
  details.append(summary, ...configuration(values));
  return details;
}

function tableOf(entries: [string, unknown][]): HTMLTableElement {
  const table = create("table", "configuration");
  const body = create("tbody");
  table.append(body);
  for (const [key, value] of entries) {
    const row = create("tr");
    const name = headCell();
    name.append(create("code", "", key));
    row.append(name, create("td", "number", inWords(value)));
    body.append(row);
  }
  return table;
}

function inWords(value: unknown): string {
  if (value === null) return "not set";
  if (Array.isArray(value)) return value.map(inWords).join(", ");
  return typeof value === "string" ? value : JSON.stringify(value);
}

const isTable = (value: unknown): value is Values => typeof value === "object" && value !== null && !Array.isArray(value);

import { create } from "../dom";

export interface Row<Item> {
  element: HTMLTableRowElement;
  update?: (item: Item) => void;
}

/** Table rows by key. A row that stays keeps its elements, and so the focus. */
export class Rows<Item> {
  private rows = new Map<string, Row<Item>>();

  constructor(
    private readonly body: HTMLElement,
    private readonly keyOf: (item: Item) => string,
    private readonly make: (item: Item) => Row<Item>,
  ) {}

  show(items: Item[]): void {
    const rows = new Map<string, Row<Item>>();
    for (const item of items) {
      const row = this.rows.get(this.keyOf(item)) ?? this.make(item);
      row.update?.(item);
      rows.set(this.keyOf(item), row);
    }
    for (const [key, { element }] of this.rows) if (!rows.has(key)) element.remove();
    this.rows = rows;
    let next = this.body.firstElementChild;
    for (const { element } of rows.values()) {
      if (element === next) next = next.nextElementSibling;
      else this.body.insertBefore(element, next);
    }
  }
}

export function headCell(className = ""): HTMLTableCellElement {
  const cell = create("th", className);
  cell.scope = "row";
  return cell;
}

/** Creates a time element. Hovering over it shows the exact time. */
export function moment(iso: string, ...shown: (string | Node)[]): HTMLTimeElement {
  const element = create("time", "moment");
  element.append(...shown);
  element.dateTime = iso;
  element.title = iso;
  return element;
}

// The Swedish locale formats dates and times as ISO 8601 does.

/** `2026-11-25 17:13` */
export const dateTime = (iso: string): string =>
  new Date(iso).toLocaleString("sv-SE", { dateStyle: "short", timeStyle: "short" });

/** `2026-11-25` */
export const day = (iso: string): string => new Date(iso).toLocaleDateString("sv-SE");

/** `17:13:08` */
export const timeOfDay = (iso: string): string => new Date(iso).toLocaleTimeString("sv-SE");

import { byId, setHidden, setText } from "../dom";
import type { Session } from "./session";
import { readStored, store } from "./storage";

/** The OR view shows what an assistant needs from two metres: tissue, force, alarm, live or not, and STOP. */
type View = "or" | "detailed";

const KEY = "graspwatch-view";

/** The view of the live page: that of the address (`?view=or`), else the person's choice, else the OR view for viewers. */
export class ViewChoice {
  private readonly root = document.documentElement;

  constructor(
    private readonly session: Session,
    private readonly onChange: () => void,
  ) {
    byId("view").addEventListener("click", () => this.toggle());
  }

  get isOr(): boolean {
    return this.root.dataset.view === "or";
  }

  /** Applies the view. Call it when the live page opens, and before the first paint. */
  open(): void {
    const asked = new URLSearchParams(location.search).get("view") ?? readStored(KEY);
    this.show(asked === "or" || (asked !== "detailed" && this.session.role === "viewer") ? "or" : "detailed");
  }

  /** Leaves the view. Call it when the live page closes: the other pages have one view only. */
  close(): void {
    delete this.root.dataset.view;
    setHidden(byId("view"), true);
  }

  toggle(): void {
    const other = this.isOr ? "detailed" : "or";
    store(KEY, other);
    this.show(other);
    this.onChange();
  }

  private show(view: View): void {
    this.root.dataset.view = view;
    setText(byId("view-text"), view === "or" ? "All details" : "OR view");
    setHidden(byId("view"), false);
  }
}

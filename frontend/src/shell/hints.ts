import { create } from "../dom";
import { readStored, store } from "./storage";

const KEY = "graspwatch-hints-seen";

/** Shows each area's hint until the person dismisses it. A dismissed hint stays hidden in this browser. */
export function showHints(root: ParentNode): void {
  const seen = seenHints();
  for (const line of root.querySelectorAll<HTMLElement>("[data-hint]")) {
    const name = line.dataset.hint ?? "";
    line.hidden = seen.has(name);
    if (line.hidden || line.querySelector("button")) continue;
    const dismiss = create("button", "dismiss", "✕");
    dismiss.type = "button";
    dismiss.setAttribute("aria-label", `Do not explain again: ${line.textContent ?? ""}`);
    dismiss.addEventListener("click", () => {
      line.hidden = true;
      store(KEY, JSON.stringify([...seenHints().add(name)]));
    });
    line.append(dismiss);
  }
}

const seenHints = (): Set<string> => new Set(JSON.parse(readStored(KEY) ?? "[]") as string[]);

/** Shows all hints again. */
export function forgetHints(root: ParentNode): void {
  store(KEY, null);
  showHints(root);
}

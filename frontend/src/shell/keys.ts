import { byId, create } from "./dom";

export interface KeyAction {
  key: string;
  shown: string;
  does: string;
  run: () => void;
}

/** Escape stops, wherever the focus is; the other keys work outside of fields. */
export function listenToKeys(stop: () => void, actions: KeyAction[]): void {
  keepListsInThePage();
  const dialog = byId<HTMLDialogElement>("keys");
  const help: KeyAction = { key: "?", shown: "?", does: "Show or hide these keys", run: () => toggle(dialog) };
  const all = [...actions, help];
  const rows = [{ shown: "Esc", does: "STOP: ends the run, motor to zero" }, ...all];
  byId("keys-list").replaceChildren(
    ...rows.flatMap(({ shown, does }) => [create("dt", "", shown), create("dd", "", does)]),
  );
  byId("help").addEventListener("click", () => toggle(dialog));
  const onKey = (event: KeyboardEvent): void => {
    if (event.key === "Escape") {
      if (!event.repeat) stop();
      dialog.close();
      return;
    }
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat || isField(event.target)) return;
    const action = all.find(({ key }) => key === event.key);
    if (!action || (dialog.open && action !== help)) return;
    event.preventDefault();
    action.run();
  };
  window.addEventListener("keydown", onKey, { capture: true });
}

/** Where the stylesheet cannot keep an open list inside the page, lists stay open instead: Esc must always get here. */
function keepListsInThePage(): void {
  if (CSS.supports("appearance", "base-select")) return;
  for (const select of document.querySelectorAll("select")) select.size = 3;
}

function toggle(dialog: HTMLDialogElement): void {
  if (dialog.open) dialog.close();
  else dialog.show(); // not modal: STOP must stay within reach
}

const isField = (target: EventTarget | null): boolean =>
  target instanceof HTMLInputElement || target instanceof HTMLSelectElement;

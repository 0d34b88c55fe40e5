import { create, setText } from "../dom";
import { deletePath, messageOf } from "../live/rest";
import type { Person } from "../shell/person";

const ARMED_MS = 5000;

/** Deletes a recording on the second press. No question holds the page up: STOP must work. */
export function deleteButton(name: string, person: Person, told: (text: string | null) => void): HTMLButtonElement {
  const button = create("button", "action needs-admin", "Delete");
  button.type = "button";
  button.dataset.testid = "recording-delete";
  button.ariaLabel = `Delete ${name}`;
  let armed: number | undefined;
  const disarm = (): void => {
    window.clearTimeout(armed);
    armed = undefined;
    setText(button, "Delete");
    button.ariaLabel = `Delete ${name}`;
  };
  button.addEventListener("click", () => {
    if (armed === undefined) {
      armed = window.setTimeout(disarm, ARMED_MS);
      setText(button, "For good?");
      button.ariaLabel = `Delete ${name} for good`;
      return;
    }
    disarm();
    person.withName((by) => {
      deletePath(`/api/recordings/${encodeURIComponent(name)}?by=${encodeURIComponent(by)}`).then(
        () => told(null),
        (error: unknown) => told(`${name} was not deleted: ${messageOf(error)}`),
      );
    });
  });
  return button;
}

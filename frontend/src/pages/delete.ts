import { create } from "../dom";
import { deletePath, messageOf } from "../live/rest";
import type { Person } from "../shell/person";
import { askFirst } from "./confirm";

/** A button that deletes a recording, and the question that it asks first, which stands at another place. */
export function deleteButton(name: string, person: Person, told: (text: string | null) => void): [HTMLElement, HTMLElement] {
  const button = create("button", "action needs-admin", "Delete");
  button.type = "button";
  button.dataset.testid = "recording-delete";
  button.ariaLabel = `Delete ${name}`;
  const question = askFirst(button, "Move it to the bin?", "Move to the bin", () => {
    person.withName((by) => {
      deletePath(`/api/recordings/${encodeURIComponent(name)}?by=${encodeURIComponent(by)}`).then(
        () => told(null),
        (error: unknown) => told(`${name} was not deleted: ${messageOf(error)}`),
      );
    });
  });
  return [button, question];
}

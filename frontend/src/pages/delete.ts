import { create } from "../dom";
import { deletePath, messageOf } from "../live/rest";
import type { Person } from "../shell/person";
import { confirmFirst } from "./confirm";

/** Creates a button that deletes a recording, and the question that it asks first, which stands elsewhere. */
export function deleteButton(name: string, person: Person, onResult: (text: string | null) => void): [HTMLElement, HTMLElement] {
  const button = create("button", "action needs-admin", "Delete");
  button.type = "button";
  button.dataset.testid = "recording-delete";
  button.ariaLabel = `Delete ${name}`;
  const question = confirmFirst(button, "Move it to the bin?", "Move to the bin", () => {
    person.withName((by) => {
      deletePath(`/api/recordings/${encodeURIComponent(name)}?by=${encodeURIComponent(by)}`).then(
        () => onResult(null),
        (error: unknown) => onResult(`${name} was not deleted: ${messageOf(error)}`),
      );
    });
  });
  return [button, question];
}

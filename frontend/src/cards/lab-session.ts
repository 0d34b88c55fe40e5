import { create, createOption, find, setHidden, setText } from "../dom";
import { beginLabSession, changeLabSession, endLabSession, messageOf } from "../live/rest";
import type { Model } from "../live/model";
import type { Person } from "../shell/person";
import type { LabSession, LabSessionRequest, SpecimenCondition } from "../wire";

const CONDITIONS: SpecimenCondition[] = ["in vivo", "in situ", "ex vivo", "phantom", "simulated"];
const TEXTS = ["species", "specimen", "operator", "protocol_number", "notes"] as const;

/** Shows the laboratory session under way, and begins, changes or ends it. */
export class LabSessionLine {
  private readonly form: HTMLFormElement;
  private readonly condition: HTMLSelectElement;
  private changed: LabSession | null = null;
  private fieldsFor: string[] | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
    private readonly person: Person,
  ) {
    this.form = find(root, "session-form", HTMLFormElement);
    this.condition = find(root, "session-condition", HTMLSelectElement);
    this.condition.replaceChildren(...CONDITIONS.map((name) => createOption(name, name)));
    find(root, "session-open").addEventListener("click", () => this.open());
    find(root, "session-end").addEventListener("click", () => void this.end());
    find(root, "session-cancel").addEventListener("click", () => setHidden(this.form, true));
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save();
    });
  }

  render(): void {
    const session = this.session;
    const fields = this.model.hello?.lab_fields ?? [];
    if (this.fieldsFor?.join("\n") !== fields.join("\n")) this.listFields(fields);
    setText(find(this.root, "session-now"), session === null ? "No session: new runs have no subject." : describe(session));
    setText(find(this.root, "session-open"), session === null ? "Begin a session" : "Change it");
    setHidden(find(this.root, "session-end"), session === null);
  }

  private get session(): LabSession | null {
    return this.model.state?.session ?? null;
  }

  private input(name: string): HTMLInputElement {
    return find(this.root, `session-${name}`, HTMLInputElement);
  }

  private listFields(names: string[]): void {
    this.fieldsFor = names;
    find(this.root, "session-fields").replaceChildren(
      ...names.map((name, i) => {
        const label = create("label", "", name);
        const input = create("input");
        input.id = `session-field-${i}`;
        input.maxLength = 100;
        label.append(input);
        return label;
      }),
    );
  }

  private open(): void {
    this.changed = this.session;
    const { changed } = this;
    this.input("subject").value = changed?.subject ?? "";
    this.condition.value = changed?.condition ?? "in vivo";
    for (const name of TEXTS) this.input(name).value = changed?.[name] ?? (name === "operator" ? (this.person.name ?? "") : "");
    this.fieldsFor?.forEach((name, i) => void (this.input(`field-${i}`).value = changed?.fields[name] ?? ""));
    this.showMessage("");
    setHidden(this.form, false);
    this.input("subject").focus();
  }

  private request(): LabSessionRequest {
    const text = (name: string): string | null => this.input(name).value.trim() || null;
    const fields = (this.fieldsFor ?? []).map((name, i) => [name, text(`field-${i}`)] as const);
    return {
      subject: this.input("subject").value.trim(),
      condition: this.condition.value as SpecimenCondition,
      species: text("species"),
      specimen: text("specimen"),
      operator: text("operator"),
      protocol_number: text("protocol_number"),
      notes: text("notes"),
      fields: Object.fromEntries(fields.filter((pair): pair is readonly [string, string] => pair[1] !== null)),
      by: this.person.name,
    };
  }

  private async save(): Promise<void> {
    const save = find(this.root, "session-save", HTMLButtonElement);
    save.disabled = true;
    try {
      const { changed } = this;
      await (changed ? changeLabSession(changed.id, { ...this.request(), version: changed.version }) : beginLabSession(this.request()));
      setHidden(this.form, true);
    } catch (error) {
      this.showMessage(`Not saved: ${messageOf(error)}`);
    } finally {
      save.disabled = false;
    }
  }

  private async end(): Promise<void> {
    try {
      await endLabSession(this.person.name);
    } catch (error) {
      this.showMessage(`Not ended: ${messageOf(error)}`);
      setHidden(this.form, false);
    }
  }

  private showMessage(text: string): void {
    setText(find(this.root, "session-message"), text);
  }
}

const describe = ({ id, subject, species, condition }: LabSession): string =>
  [`Session ${id}: ${subject}`, species ?? "", condition].filter(Boolean).join(", ");

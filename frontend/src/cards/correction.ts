import { createOption, find, setHidden, setText } from "../dom";
import { correctTruth, messageOf } from "../live/rest";
import type { Model } from "../live/model";
import type { Person } from "../shell/person";
import type { GraspRemark, GraspTruth } from "../wire";
import { REMARKS, tissueNameOf } from "./truth";

/** States or corrects what was held in a finished grasp. */
export class CorrectionForm {
  private readonly form: HTMLFormElement;
  private readonly held: HTMLInputElement;
  private readonly place: HTMLInputElement;
  private readonly remark: HTMLSelectElement;
  private readonly why: HTMLInputElement;
  private grasp = 0;
  private run: string | null = null;
  private version = 0;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
    private readonly person: Person,
  ) {
    this.form = find(root, "correction", HTMLFormElement);
    this.held = find(root, "correction-held", HTMLInputElement);
    this.place = find(root, "correction-place", HTMLInputElement);
    this.remark = find(root, "correction-remark", HTMLSelectElement);
    this.why = find(root, "correction-why", HTMLInputElement);
    this.remark.replaceChildren(createOption("", "none"), ...REMARKS.map((remark) => createOption(remark, remark)));
    find(root, "correction-cancel").addEventListener("click", () => setHidden(this.form, true));
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save();
    });
  }

  /** Whether this person may state what was held. */
  get isAllowed(): boolean {
    return this.person.may("operator") && this.model.graspsOfRun !== null;
  }

  open(grasp: number): void {
    const before = this.model.truths.get(grasp);
    this.grasp = grasp;
    this.run = this.model.graspsOfRun;
    this.version = before?.version ?? 0;
    setText(find(this.root, "correction-title"), `Grasp ${grasp}`);
    find(this.root, "correction-tissues").replaceChildren(...this.model.tissues.map(({ name, title }) => createOption(name, title)));
    this.held.value = before?.held ?? "";
    this.place.value = before?.place ?? "";
    this.remark.value = before?.remark ?? "";
    this.why.value = "";
    setHidden(find(this.root, "correction-why-field"), before === undefined);
    this.showMessage("");
    setHidden(this.form, false);
    this.form.scrollIntoView({ block: "nearest" });
    this.held.focus();
  }

  private async save(): Promise<void> {
    const { run } = this;
    if (run === null) return;
    const held = tissueNameOf(this.held.value);
    const why = this.why.value.trim();
    try {
      const truth: GraspTruth = await correctTruth(run, this.grasp, {
        held: held === "" ? null : held,
        remark: this.remark.value === "" ? null : (this.remark.value as GraspRemark),
        place: this.place.value.trim() || null,
        version: this.version,
        why: why === "" ? null : why,
        by: this.person.name,
      });
      this.model.onTruth(truth);
      setHidden(this.form, true);
    } catch (error) {
      this.showMessage(`Not saved: ${messageOf(error)}`);
    }
  }

  private showMessage(text: string): void {
    setText(find(this.root, "correction-message"), text);
  }
}

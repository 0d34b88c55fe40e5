import { create, find, setText } from "../dom";
import { NO_VALUE, newtons, shortTime } from "../format";
import type { Model } from "../live/model";
import { tissueStyles, UNKNOWN_SLOT } from "../tissues";
import type { TissueInfo } from "../wire";

const FAR_OFF_N = 100;

/** Formats a force error. The error of a diverged filter is shown as a bound. */
const ofForce = (errorN: number | null | undefined): string =>
  Math.abs(errorN ?? 0) > FAR_OFF_N ? `>\u202f${FAR_OFF_N}\u202fN` : newtons(errorN);

interface Row {
  name: string;
  converged: HTMLElement;
  error: HTMLElement;
}

/** Shows when each filter converged and its force error during a grasp: columns of the paper's Table V. */
export class CriteriaTable {
  private rows: Row[] = [];
  private rowsFor: TissueInfo[] | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
  ) {}

  render(): void {
    const { tissues, identification } = this.model;
    if (this.rowsFor !== tissues) this.build(tissues);
    for (const { name, converged, error } of this.rows) {
      const time = identification?.convergence_s[name];
      setText(converged, typeof time === "number" ? shortTime(time) : NO_VALUE);
      setText(error, ofForce(identification?.force_error_n[name]));
    }
  }

  private build(tissues: TissueInfo[]): void {
    this.rowsFor = tissues;
    const styles = tissueStyles(tissues).filter(({ slot }) => slot !== UNKNOWN_SLOT);
    const lines = styles.map(({ name, title, slot, mark }) => {
      const line = create("tr");
      const tissue = create("th", "what");
      tissue.scope = "row";
      tissue.dataset.slot = slot;
      tissue.append(create("span", "swatch", mark), title);
      const [converged, error] = [create("td"), create("td")];
      line.append(tissue, converged, error);
      return { line, row: { name, converged, error } };
    });
    this.rows = lines.map(({ row }) => row);
    find(this.root, "criteria-body").replaceChildren(...lines.map(({ line }) => line));
  }
}

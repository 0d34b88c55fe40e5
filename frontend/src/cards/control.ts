import { byId, setHidden, setText } from "../dom";
import { giveControlBack, messageOf, takeControl } from "../live/rest";
import type { State } from "../wire";
import type { Person } from "../shell/person";

/** Who has control of the tool, where people are known by tokens; taking it over, giving it back. */
export class ControlLine {
  constructor(
    private readonly person: Person,
    private readonly told: (failure: string) => void,
  ) {
    byId("control-take").addEventListener("click", () => this.ask(takeControl(), "Control was not taken over"));
    byId("control-give").addEventListener("click", () => this.ask(giveControlBack(), "Control was not given back"));
  }

  render(state: State | null): void {
    const holder = state?.demo ? null : (state?.control ?? null);
    setHidden(byId("control"), !this.person.isSignedIn || holder === null);
    const mine = holder === this.person.name;
    setText(byId("control-text"), mine ? "You have control." : `${holder} has control.`);
    setHidden(byId("control-take"), mine);
    setHidden(byId("control-give"), !mine || state?.run !== null);
  }

  private ask(asked: Promise<unknown>, failure: string): void {
    asked.catch((error: unknown) => this.told(`${failure}: ${messageOf(error)}`));
  }
}

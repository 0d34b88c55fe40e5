import { createOption, find, setAttribute, setData, setHidden, setText } from "../dom";
import { count, inOneLine } from "../format";
import { arm, beginSpot, declineReference, disarm, getProtocols, messageOf, startRun } from "../live/rest";
import type { Model } from "../live/model";
import type { Person } from "../shell/person";
import type { Hello, Phase, ProtocolInfo, Run, RunRequest, Safety, State } from "../wire";
import { ControlLine } from "./control";
import { drawWaveform } from "./waveform";

/** Text of each phase. Null: the safety state is shown instead. */
const PHASE: Record<Phase, string | null> = {
  starting: "starting up",
  idle: null,
  running: null,
  replay: "no tool",
  faulted: "FAULT",
};
const SAFETY: Record<Safety, string> = {
  disarmed: "disarmed",
  testing: "testing",
  armed: "ARMED",
  running: "running",
  "holding back": "holding back",
  "let go": "let go",
  stopped: "stopped",
  faulted: "FAULT",
};
/** Safety states in which the button disarms the tool. In the others it arms it. */
const ARMED: Safety[] = ["testing", "armed", "running", "holding back", "let go"];

const REFERENCE_PROTOCOL = "reference_grasp";

/** Whether the page asks for a reference grasp before it starts this protocol. */
export const asksForReference = (state: State | null, protocol: string): boolean => state?.reference.wanted === true && protocol !== REFERENCE_PROTOCOL;

/** Chooses a protocol, previews it and starts it. */
export class ProtocolPanel {
  private readonly protocol: HTMLSelectElement;
  private readonly tissue: HTMLSelectElement;
  private readonly cycles: HTMLInputElement;
  private readonly start: HTMLButtonElement;
  private readonly armButton: HTMLButtonElement;
  private readonly scaleReason: HTMLInputElement;
  private readonly message: HTMLElement;
  private readonly question: HTMLElement;
  private readonly control: ControlLine;
  private protocols: ProtocolInfo[] = [];
  private startedRun: string | null = null;
  private tissuesFor: Hello["holdable"] | null = null;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
    private readonly person: Person,
  ) {
    this.protocol = find(root, "protocol", HTMLSelectElement);
    this.tissue = find(root, "tissue-select", HTMLSelectElement);
    this.cycles = find(root, "cycles", HTMLInputElement);
    this.start = find(root, "start", HTMLButtonElement);
    this.armButton = find(root, "arm", HTMLButtonElement);
    this.scaleReason = find(root, "scale-reason", HTMLInputElement);
    this.message = find(root, "run-message");
    this.question = find(root, "reference-question");
    find(root, "reference-take").addEventListener("click", () => void this.takeReference());
    find(root, "reference-decline").addEventListener("click", () => void this.goOnWithoutReference());
    this.control = new ControlLine(root, person, (failure) => this.showMessage(failure, "failed"));
    this.protocol.addEventListener("change", () => this.preview());
    this.armButton.addEventListener("click", () => void this.armOrDisarm());
    find(root, "run-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.submit();
    });
  }

  /** Fetches the protocols. Called at each new connection, because the server may offer others. */
  async load(): Promise<void> {
    try {
      this.protocols = await getProtocols();
    } catch (error) {
      if (this.protocols.length === 0) setText(find(this.root, "waveform-facts"), `No protocols: ${messageOf(error)}.`);
      return;
    }
    const chosen = this.protocol.value;
    this.protocol.replaceChildren(...this.protocols.map(({ name, title }) => createOption(name, title)));
    if (this.protocols.some(({ name }) => name === chosen)) this.protocol.value = chosen;
    this.protocol.disabled = this.protocols.length === 0;
    this.preview();
  }

  render(): void {
    const { hello, state } = this.model;
    if (hello && this.tissuesFor !== hello.holdable) this.listTissues(hello);
    setHidden(find(this.root, "run-form"), this.model.hasNoTool);
    setHidden(find(this.root, "scale-override"), !this.mayOverrideScale);
    if (state?.reference.wanted !== true) setHidden(this.question, true);
    this.control.render(state);
    setText(find(this.root, "phase"), state ? (PHASE[state.phase] ?? this.safetyInWords(state)) : "");
    setData(find(this.root, "phase"), "phase", state?.safety === "faulted" ? "faulted" : (state?.phase ?? ""));
    setText(this.armButton, this.isArmed(state) ? "Disarm" : "Arm");
    setHidden(this.armButton, !this.model.hasMotor);
    setHidden(find(this.root, "cycles-field"), !this.model.hasMotor);
    this.armButton.disabled = this.start.disabled = state?.safety === "faulted";
    setText(find(this.root, "run-now"), this.runInWords());
    if (this.startedRun && state?.run === null && state.last_run?.id === this.startedRun) this.forget();
    if (hello && state) this.nameHeldTissue(state.simulated_tissue);
  }

  private safetyInWords(state: State): string {
    if (this.model.hasMotor) return SAFETY[state.safety];
    return state.run === null ? "Ready" : "Running";
  }

  submitByKey(): void {
    find(this.root, "run-form", HTMLFormElement).requestSubmit();
  }

  /** Begins a new spot in the run under way. */
  async beginSpot(): Promise<void> {
    if (!this.person.may("operator")) return;
    try {
      await beginSpot(this.person.name);
    } catch (error) {
      this.showMessage(`No new spot: ${messageOf(error)}`, "failed");
    }
  }

  /** Clears the message about the last start. */
  forget(): void {
    this.startedRun = null;
    setText(this.message, "");
  }

  private async submit(): Promise<void> {
    if (this.start.ariaBusy === "true" || !this.person.may("operator")) return;
    if (asksForReference(this.model.state, this.protocol.value)) {
      setHidden(this.question, false);
      find(this.root, "reference-take").focus();
      return;
    }
    await this.startNow(this.request());
  }

  private async takeReference(): Promise<void> {
    setHidden(this.question, true);
    await this.startNow({ ...this.request(), protocol: REFERENCE_PROTOCOL, cycles: null, tissue: null });
  }

  private async goOnWithoutReference(): Promise<void> {
    setHidden(this.question, true);
    try {
      await declineReference(this.person.name);
      await this.startNow(this.request());
    } catch (error) {
      this.showMessage(`Not started: ${messageOf(error)}`, "failed");
    }
  }

  private async startNow(request: RunRequest): Promise<void> {
    this.showMessage("Starting…", "pending");
    setAttribute(this.start, "aria-busy", "true");
    try {
      const run = await startRun(request);
      this.startedRun = run.id;
      const planned = this.model.hasMotor ? `, ${count(run.cycles, "grasp")}` : ": close the jaws by hand, and press STOP at the end";
      this.showMessage(`Started: ${this.titleOf(run)}${planned}.`, "done");
    } catch (error) {
      this.showMessage(`Not started: ${messageOf(error)}`, "failed");
    } finally {
      setAttribute(this.start, "aria-busy", "false");
    }
  }

  private readonly isArmed = (state: State | null): boolean => state !== null && ARMED.includes(state.safety);

  private async armOrDisarm(): Promise<void> {
    const armed = this.isArmed(this.model.state);
    this.showMessage(armed ? "Disarming…" : "Testing the tool…", "pending");
    try {
      await (armed ? disarm(this.person.name) : arm(this.person.name, this.overrideReason));
      this.forget(); // the card's heading shows the safety state
    } catch (error) {
      this.showMessage(messageOf(error), "failed");
    }
  }

  private request(): RunRequest {
    const cycles = this.cycles.value.trim();
    return {
      protocol: this.protocol.value,
      cycles: cycles === "" ? null : Number(cycles),
      tissue: this.tissue.value === "" || this.protocol.value === REFERENCE_PROTOCOL ? null : this.tissue.value,
      by: this.person.name,
      unmeasured_scale: this.overrideReason,
    };
  }

  /** Whether a person may give a reason to arm a real tool whose force scale is not measured. */
  private get mayOverrideScale(): boolean {
    const tool = this.model.hello?.tool;
    return tool?.kind === "nidaq" && tool.has_motor && !tool.force_scale.measured && this.person.may("admin");
  }

  private get overrideReason(): string | null {
    const reason = this.scaleReason.value.trim();
    return this.mayOverrideScale && reason !== "" ? reason : null;
  }

  private preview(): void {
    const protocol = this.protocols.find(({ name }) => name === this.protocol.value);
    if (!protocol) return;
    drawWaveform(this.root, protocol);
    this.cycles.value = String(protocol.cycles);
  }

  private listTissues(hello: Hello): void {
    this.tissuesFor = hello.holdable;
    setHidden(find(this.root, "tissue-choice"), hello.holdable.length === 0);
    const chosen = this.tissue.value;
    const options = hello.holdable.map(({ name, title, in_library: known }) => createOption(name, known ? title : `${title} (not in the library)`));
    this.tissue.replaceChildren(createOption("", "As before"), ...options);
    if (hello.holdable.some(({ name }) => name === chosen)) this.tissue.value = chosen;
  }

  private nameHeldTissue(tissue: string | null): void {
    const first = this.tissue.options[0];
    const title = this.model.hello?.holdable.find(({ name }) => name === tissue)?.title;
    if (first) setText(first, title === undefined ? "As before" : `As before (${title})`);
  }

  private runInWords(): string {
    const { state } = this.model;
    if (state?.safety === "faulted") return `FAULT, the motor is at zero: ${state.safety_why ?? "see the log"}. Acknowledge its alarm to go on.`;
    if (state?.phase === "faulted") return `The tool is at fault: ${inOneLine(state.faults) || "see the log"}`;
    if (this.model.hasNoTool) return "This service only shows recordings: there is no motor to start.";
    const run = state?.run ?? state?.last_run;
    if (!run) return "";
    if (run.protocol === REFERENCE_PROTOCOL) return this.referenceInWords(run, state);
    const done = this.model.hasMotor ? `${run.grasps} of ${count(run.cycles, "grasp")} done` : `${count(run.grasps, "grasp")} so far`;
    if (run.state === "running") return `Running ${this.titleOf(run)}: ${done}. Control: ${state?.control ?? "nobody"}.`;
    const why = run.why === null ? "" : `: ${run.why}`;
    return `Last run ${this.titleOf(run)} ${run.state} after ${count(run.grasps, "grasp")}${why}`;
  }

  private referenceInWords(run: Run, state: State | null): string {
    if (run.state === "running") return `Taking the reference grasp. Control: ${state?.control ?? "nobody"}.`;
    const { taken_at: takenAt, stall_v: stallV, problem } = state?.reference ?? {};
    if (problem) return `No reference grasp: ${problem}`;
    return takenAt ? `The day has its reference grasp: the drive stalls at ${stallV?.toFixed(2)} V.` : "The reference grasp is being measured.";
  }

  private readonly titleOf = (run: Run): string => this.protocols.find(({ name }) => name === run.protocol)?.title ?? run.protocol;

  private showMessage(text: string, outcome: "pending" | "done" | "failed"): void {
    setText(this.message, text);
    setData(this.message, "outcome", outcome);
  }
}

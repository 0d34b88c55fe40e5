import { byId, setAttribute, setHidden, setText } from "../dom";
import { getSession, messageOf, onUnknown, signIn, signOut } from "../live/rest";
import type { Role, SessionInfo } from "../wire";

const RANK: Record<Role, number> = { viewer: 1, operator: 2, admin: 3 };

/** Who the server says this browser is. Signing in and out loads the page anew: nothing of the one before stays. */
export class Session {
  private info: SessionInfo | null = null;
  private readonly dialog = byId("sign-in", HTMLDialogElement);
  private readonly token = byId("sign-in-token", HTMLInputElement);

  constructor() {
    byId("sign-in-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.send(signIn(this.token.value.trim()));
    });
    byId("sign-out").addEventListener("click", () => void this.send(signOut()));
    byId("sign-in-close").addEventListener("click", () => this.close());
    onUnknown(() => void this.check());
  }

  /** Whether this service knows people by tokens. */
  get needed(): boolean {
    return this.info?.needed ?? false;
  }

  get name(): string | null {
    return this.info?.name ?? null;
  }

  get role(): Role | null {
    return this.info?.role ?? null;
  }

  /** Without an answer the server decides when it is asked. */
  may(role: Role): boolean {
    return this.role === null || RANK[this.role] >= RANK[role];
  }

  /** Asks the server; false: somebody has to sign in first, and the dialog says so. */
  async load(): Promise<boolean> {
    this.info = await getSession().catch(() => null);
    setAttribute(document.documentElement, "data-role", this.role ?? "");
    const stranger = this.needed && this.name === null;
    if (stranger) this.open();
    return !stranger;
  }

  /** The server may have forgotten who this is. */
  async check(): Promise<void> {
    const now = await getSession().catch(() => null);
    if (now?.needed && now.name === null && (!this.needed || this.name !== null)) location.reload();
  }

  open(): void {
    const signedIn = this.name !== null;
    if (signedIn) setText(byId("sign-in-heading"), `${this.name}, ${this.role}`);
    setHidden(byId("sign-in-now"), signedIn);
    setHidden(byId("sign-in-form"), signedIn);
    setHidden(byId("sign-in-buttons"), !signedIn);
    if (!this.dialog.open) this.dialog.show(); // not modal: STOP must stay within reach
    if (!signedIn) this.token.focus();
  }

  /** A stranger has nothing else to do here. */
  close(): void {
    if (this.name !== null) this.dialog.close();
  }

  private async send(asked: Promise<unknown>): Promise<void> {
    try {
      await asked;
      location.reload();
    } catch (error) {
      this.token.select();
      setText(byId("sign-in-message"), messageOf(error));
    }
  }
}

import { byId, setAttribute, setHidden, setText } from "../dom";
import { getSession, messageOf, onSignedOut, signIn, signOut } from "../live/rest";
import type { Role, SessionInfo } from "../wire";

const RANK: Record<Role, number> = { viewer: 1, operator: 2, admin: 3 };

/** The person that this browser is signed in as. Signing in or out reloads the page, so that no earlier data remain. */
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
    onSignedOut(() => void this.check());
  }

  /** Whether this service requires a sign-in with a token. */
  get needed(): boolean {
    return this.info?.needed ?? false;
  }

  get name(): string | null {
    return this.info?.name ?? null;
  }

  get role(): Role | null {
    return this.info?.role ?? null;
  }

  /** Whether the role allows something. If the role is not known, the server decides on the request. */
  may(role: Role): boolean {
    return this.role === null || RANK[this.role] >= RANK[role];
  }

  /** Asks the server for the session. Returns false, and opens the dialog, if the person has to sign in first. */
  async load(): Promise<boolean> {
    this.info = await getSession().catch(() => null);
    setAttribute(document.documentElement, "data-role", this.role ?? "");
    const mustSignIn = this.needed && this.name === null;
    if (mustSignIn) this.open();
    return !mustSignIn;
  }

  /** Reloads the page if the server no longer accepts the sign-in. */
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

  /** Closes the dialog, unless the person has to sign in first. */
  close(): void {
    if (this.name !== null) this.dialog.close();
  }

  private async send(request: Promise<unknown>): Promise<void> {
    try {
      await request;
      location.reload();
    } catch (error) {
      this.token.select();
      setText(byId("sign-in-message"), messageOf(error));
    }
  }
}

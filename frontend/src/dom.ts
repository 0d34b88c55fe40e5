const SVG = "http://www.w3.org/2000/svg";

/** Returns the element with this id inside `root`. Throws where there is none, or one of another kind. */
export function find(root: ParentNode, id: string): HTMLElement;
export function find<Kind extends Element>(root: ParentNode, id: string, kind: new () => Kind): Kind;
export function find(root: ParentNode, id: string, kind: new () => Element = HTMLElement): Element {
  const element = root.querySelector(`#${id}`);
  if (!(element instanceof kind)) throw new Error(`the page has no ${kind.name} #${id}`);
  return element;
}

/** Returns an element of `index.html`, which is there on every page. */
export function byId(id: string): HTMLElement;
export function byId<Kind extends Element>(id: string, kind: new () => Kind): Kind;
export function byId(id: string, kind: new () => Element = HTMLElement): Element {
  return find(document, id, kind);
}

export function create<Tag extends keyof HTMLElementTagNameMap>(
  tag: Tag,
  className = "",
  text = "",
): HTMLElementTagNameMap[Tag] {
  const element = document.createElement(tag);
  element.className = className;
  element.textContent = text;
  return element;
}

export function createOption(value: string, text: string): HTMLOptionElement {
  const option = create("option", "", text);
  option.value = value;
  return option;
}

export function createSvg(tag: string, attributes: Record<string, string | number>): SVGElement {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  return element;
}

// Each setter below changes the document only if the value differs: cards are rendered thirty times a second.

export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function setHidden(element: HTMLElement, hidden: boolean): void {
  if (element.hidden !== hidden) element.hidden = hidden;
}

export function setData(element: HTMLElement, key: string, value: string): void {
  if (element.dataset[key] !== value) element.dataset[key] = value;
}

export function setAttribute(element: Element, name: string, value: string): void {
  if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}

/** Sets a custom property that the stylesheet turns into a length. It needs no style attribute, which the CSP forbids. */
export function setProperty(element: HTMLElement, name: string, value: number): void {
  const text = value.toFixed(4);
  if (element.style.getPropertyValue(name) !== text) element.style.setProperty(name, text);
}

/** Returns the color of a custom property in the current theme. */
export const cssColor = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Fills `box` with a page's markup and returns its root element. The markup comes with the program, never from data. */
export function fill(box: HTMLElement, markup: string): HTMLElement {
  box.innerHTML = markup;
  const root = box.firstElementChild;
  if (!(root instanceof HTMLElement)) throw new Error("a page without an element");
  return root;
}

import { create, setText } from "../dom";

/** Fills a `<dl class="facts">`, and changes only texts that differ. */
export function showFacts(list: HTMLElement, facts: Record<string, string>): void {
  const entries = Object.entries(facts);
  if (list.childElementCount !== entries.length) list.replaceChildren(...entries.map(emptyGroup));
  entries.forEach(([name, value], i) => {
    const [term, text] = list.children[i]?.children ?? [];
    if (term) setText(term, name);
    if (text) setText(text, value);
  });
}

function emptyGroup(): HTMLElement {
  const group = create("div");
  group.append(create("dt"), create("dd"));
  return group;
}

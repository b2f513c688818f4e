//! Elements of the page.

/** Element with properties and children. Attributes have a `-` in their name. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Record<string, unknown> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.includes("-")) element.setAttribute(name, String(value));
    else (element as unknown as Record<string, unknown>)[name] = value;
  }
  element.append(...children);
  return element;
}

/** Button with an icon, and a name for pointers and assistive programs. */
export function iconButton(name: string, icon: string, pressed: () => void): HTMLButtonElement {
  const button = make("button", { type: "button", onclick: pressed });
  setIcon(button, name, icon);
  return button;
}

export function setIcon(button: HTMLButtonElement, name: string, icon: string): void {
  if (button.title === name) return;
  button.title = name;
  button.setAttribute("aria-label", name);
  button.innerHTML = icon;
}

/** Sets a text only when it changes: the layout stays. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

// Buttons that copy texts to the clipboard.

import { button, setText } from "../dom";

/** Return a button that copies a text. If the browser has no clipboard for this page, it selects the text in `shown` instead. */
export function copyButton(words: string, text: () => string, shown: () => Element, test: string): HTMLButtonElement {
  const select = () => getSelection()?.selectAllChildren(shown());
  const confirm = () => {
    setText(made, "Copied");
    setTimeout(() => setText(made, words), 1500);
  };
  const made = button(
    words,
    () => {
      const done = navigator.clipboard?.writeText(text());
      if (done) void done.then(confirm, select);
      else select();
    },
    { class: "small", test },
  );
  return made;
}

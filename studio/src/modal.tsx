// A dialog that has the page to itself: nothing of the page can be pressed beside it, or lies half under its buttons.

import type { ComponentChildren } from "preact";
import { useLayoutEffect, useRef } from "preact/hooks";

interface Props {
  label: string;
  close: () => void;
  children: ComponentChildren;
}

/** Close a dialog that is pressed beside its box, where its backdrop is. */
export function beside(event: MouseEvent): void {
  const dialog = event.currentTarget as HTMLDialogElement;
  const { left, right, top, bottom } = dialog.getBoundingClientRect();
  const { clientX: x, clientY: y } = event;
  if (event.target === dialog && (x < left || x > right || y < top || y > bottom)) {
    event.preventDefault(); // or the page below takes the focus that closing gives back
    dialog.close();
  }
}

/** Each button in it closes it, as Escape and a press beside it do; what had the focus before gets it again. */
export function Modal({ label, close, children }: Props) {
  const box = useRef<HTMLDialogElement>(null);
  useLayoutEffect(() => {
    box.current?.showModal();
  }, []);
  return (
    <dialog ref={box} class="small" aria-label={label} onClose={close} onMouseDown={beside}>
      <form method="dialog">{children}</form>
    </dialog>
  );
}

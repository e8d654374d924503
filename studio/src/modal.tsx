// A dialog that has the page to itself: nothing of the page can be pressed beside it, or lies half under its buttons.

import type { ComponentChildren } from "preact";
import { useLayoutEffect, useRef } from "preact/hooks";

interface Props {
  label: string;
  close: () => void;
  children: ComponentChildren;
}

/** Each button in it closes it, as Escape does; what had the focus before gets it again. */
export function Modal({ label, close, children }: Props) {
  const box = useRef<HTMLDialogElement>(null);
  useLayoutEffect(() => {
    box.current?.showModal();
  }, []);
  return (
    <dialog ref={box} class="small" aria-label={label} onClose={close}>
      <form method="dialog">{children}</form>
    </dialog>
  );
}

// A button with a list under it, which closes on a choice, on Escape and on a click anywhere else.

import type { ComponentChildren } from "preact";
import { useLayoutEffect, useRef, useState } from "preact/hooks";

interface Props {
  id: string;
  label: string;
  disabled: boolean;
  children?: ComponentChildren;
}

export function Menu({ id, label, disabled, children }: Props) {
  const [open, setOpen] = useState(false);
  const whole = useRef<HTMLDivElement>(null);
  const button = useRef<HTMLButtonElement>(null);
  const shown = open && !disabled;
  useLayoutEffect(() => {
    // before anything is drawn: a key that comes at once is heard
    if (!shown) {
      return undefined;
    }
    const elsewhere = (event: Event): void => {
      if (!whole.current?.contains(event.target as Node)) {
        setOpen(false);
      }
    };
    const escape = (event: KeyboardEvent): void => {
      if (event.key === "Escape") {
        event.stopPropagation();
        setOpen(false);
        button.current?.focus();
      }
    };
    document.addEventListener("pointerdown", elsewhere, true);
    document.addEventListener("focusin", elsewhere, true);
    document.addEventListener("keydown", escape, true);
    return () => {
      document.removeEventListener("pointerdown", elsewhere, true);
      document.removeEventListener("focusin", elsewhere, true);
      document.removeEventListener("keydown", escape, true);
    };
  }, [shown]);
  return (
    <div class="menu" ref={whole}>
      <button ref={button} aria-haspopup="menu" aria-expanded={shown} id={id} disabled={disabled} onClick={() => setOpen(!open)}>
        {label}
      </button>
      {shown && (
        <div role="menu" onClick={() => setOpen(false)}>
          {children}
        </div>
      )}
    </div>
  );
}

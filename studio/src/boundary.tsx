// What throws in one panel stays in that panel: the others go on, and it can be shown again.

import { Component, type ComponentChildren } from "preact";

interface Props {
  /** What the panel is called in its sentence. */
  name: string;
  children?: ComponentChildren;
}

export class Boundary extends Component<Props, { error: string | null }> {
  override state: { error: string | null } = { error: null };

  override componentDidCatch(error: unknown): void {
    console.warn(this.props.name, error);
    this.setState({ error: error instanceof Error ? error.message : String(error) });
  }

  override render() {
    const { error } = this.state;
    return error === null ? (
      this.props.children
    ) : (
      <section class="panel broken" role="alert">
        <p>
          The panel of {this.props.name} stopped ({error}). Nothing else is touched.
        </p>
        <button onClick={() => this.setState({ error: null })}>Show it again</button>
      </section>
    );
  }
}

// Colours of a few things side by side, such as layers: the same in the panels and in space. None of them is that of an error.

export const HUES: readonly string[] = ["#4a90d9", "#d98c3a", "#5aa864", "#b169c4", "#d0b52e", "#3fa7a0", "#d9709f", "#a58a68"];

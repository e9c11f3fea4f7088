// Colours for a few things side by side, such as layers; panels and view use the same. None of them is the error colour.

export const HUES: readonly string[] = ["#4a90d9", "#d98c3a", "#5aa864", "#b169c4", "#d0b52e", "#3fa7a0", "#d9709f", "#a58a68"];

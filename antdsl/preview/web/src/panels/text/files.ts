// Names of files: the server sends the same file with a short name or with its folders.

/** Return whether two names refer to the same file: they are equal, or one is the end of the other. */
export function same(one: string, other: string): boolean {
  return one === other || one.endsWith(`/${other}`) || other.endsWith(`/${one}`);
}

export function shortName(file: string): string {
  return file.split("/").pop() ?? file;
}

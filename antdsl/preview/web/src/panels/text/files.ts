// Names of files: the server says the same file in short or with its folders.

/** Whether two names mean one file: the same, or one the end of the other. */
export function same(one: string, other: string): boolean {
  return one === other || one.endsWith(`/${other}`) || other.endsWith(`/${one}`);
}

export function shortName(file: string): string {
  return file.split("/").pop() ?? file;
}

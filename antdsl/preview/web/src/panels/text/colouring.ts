// Colours for programs and scenes. Programs use the language's patterns for editors; the first matching pattern wins.

import { HighlightStyle, StreamLanguage, type StreamParser } from "@codemirror/language";
import { Tag } from "@lezer/highlight";
import grammar from "./antdsl.tmLanguage.json";

interface Pattern {
  match: RegExp;
  classes: string[]; // classes of the groups, from the first group on; one class for the whole match if there are no groups
}
interface Rule {
  match: string;
  name?: string;
  captures?: Record<string, { name: string }>;
}

// Prefixes of scopes, with their colours. Both colours have a contrast of at least 4.5:1.
const SHOWN: [string, string, Record<string, string>][] = [
  ["comment", "light-dark(#6b6658, #8f9199)", { fontStyle: "italic" }],
  ["string", "light-dark(#3f6b21, #a8cf8e)", {}],
  ["constant.numeric", "light-dark(#9a4a00, #f0b37e)", {}],
  ["keyword.other.unit", "light-dark(#8a5a00, #d9b36c)", {}],
  ["storage", "light-dark(#7a2e8e, #d3a4ec)", { fontWeight: "600" }],
  ["keyword.control", "light-dark(#7a2e8e, #d3a4ec)", {}],
  ["keyword.operator.word", "light-dark(#7a2e8e, #d3a4ec)", {}],
  ["entity.name.type", "light-dark(#0b5a8a, #82c8f5)", { fontWeight: "600" }],
  ["entity.name.function", "light-dark(#0b5a8a, #82c8f5)", {}],
  ["support.function", "light-dark(#0a6a63, #74d3c4)", {}],
  ["support.type", "light-dark(#0a6a63, #74d3c4)", {}],
  ["variable.parameter", "light-dark(#5d5340, #c9c0a8)", {}],
  ["variable.language", "light-dark(#a02c4e, #f49ab0)", {}],
  ["constant.other", "light-dark(#9a4a00, #f0b37e)", {}],
  ["keyword.operator", "light-dark(#5f6169, #a6a8b1)", {}],
  ["punctuation", "light-dark(#5f6169, #a6a8b1)", {}],
];
const TAGS = new Map(SHOWN.map(([scope]) => [scope, Tag.define()] as const));

export const colours = HighlightStyle.define(
  SHOWN.map(([scope, color, more]) => ({ tag: TAGS.get(scope) as Tag, color, ...more })),
);

/** Return the class name for a scope's colour, without dots, which are separators there. */
function family(scope: string): string {
  return (SHOWN.find(([start]) => scope.startsWith(start))?.[0] ?? "").replaceAll(".", "-");
}

const ANT: Pattern[] = (grammar.patterns as Rule[]).map((rule) => ({
  match: new RegExp(rule.match, "dy"),
  classes: rule.captures ? Object.values(rule.captures).map((each) => family(each.name)) : [family(rule.name ?? "")],
}));

// Scenes: comments, keys, words, numbers with unit.
const YAML: Pattern[] = (
  [
    ["#.*$", ["comment"]],
    ["(\"[^\"]*\"?|'[^']*'?)", ["string"]],
    ["([A-Za-z_][\\w.-]*)(?=\\s*:(?:\\s|$))", ["entity.name.function"]],
    [
      "(-?\\d+(?:\\.\\d+)?(?:[eE][+-]?\\d+)?)([ \\t]*(?:%|[a-z]+(?:/[a-z]+)?)(?![\\w.]))?",
      ["constant.numeric", "keyword.other.unit"],
    ],
    ["(true|false|null|yes|no)\\b", ["keyword.control"]],
    ["[A-Za-z_][\\w./-]*", [""]],
    ["[-{}\\[\\],:&*|>]", ["punctuation"]],
  ] as [string, string[]][]
).map(([match, classes]) => ({ match: new RegExp(match, "dy"), classes: classes.map(family) }));

type Piece = [number, number, string];

function parser(name: string, patterns: Pattern[]): StreamParser<{ pieces: Piece[] }> {
  return {
    name,
    startState: () => ({ pieces: [] }),
    copyState: (state) => ({ pieces: [...state.pieces] }),
    token(stream, state) {
      if (stream.sol()) state.pieces = [];
      for (;;) {
        const piece = state.pieces[0];
        if (piece) {
          if (stream.pos < piece[0]) {
            stream.pos = piece[0]; // blanks between two groups
            return null;
          }
          state.pieces.shift();
          stream.pos = piece[1];
          return piece[2] || null;
        }
        state.pieces = pieces(patterns, stream.string, stream.pos);
        if (!state.pieces.length) {
          stream.next();
          return null;
        }
      }
    },
    tokenTable: Object.fromEntries([...TAGS].map(([scope, tag]) => [family(scope), tag])),
  };
}

/** Return the match of the first matching pattern at a position of a line. */
function pieces(patterns: Pattern[], line: string, at: number): Piece[] {
  for (const { match, classes } of patterns) {
    match.lastIndex = at;
    const found = match.exec(line);
    const spans = found?.indices;
    if (!found || !spans || found[0] === "") continue;
    if (found.length === 1) return [[at, at + found[0].length, classes[0] ?? ""]];
    const groups: Piece[] = [];
    for (let number = 1; number < spans.length; number++) {
      const span = spans[number] as [number, number] | undefined;
      if (span && span[1] > span[0]) groups.push([span[0], span[1], classes[number - 1] ?? ""]);
    }
    if (groups.length) return groups;
  }
  return [];
}

export const ant = StreamLanguage.define(parser("ant", ANT));
export const yaml = StreamLanguage.define(parser("yaml", YAML));

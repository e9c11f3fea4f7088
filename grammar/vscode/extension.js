// Starts `antdsl lsp` and keeps it beside the editor. Colours and snippets work without it.
const { workspace, window, commands } = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

async function start() {
  const [command, ...args] = workspace.getConfiguration("antdsl").get("command");
  client = new LanguageClient(
    "antdsl",
    "antdsl",
    { command, args },
    {
      documentSelector: [
        { scheme: "file", language: "antdsl" },
        { scheme: "untitled", language: "antdsl" },
        { scheme: "file", language: "yaml" },
      ],
    }
  );
  try {
    await client.start();
  } catch (problem) {
    client = undefined;
    window.showWarningMessage(
      `antdsl: \`${command}\` did not start (${problem.message}). Install it with \`pip install "antdsl[lsp]"\`, ` +
        "or name it in the setting `antdsl.command`."
    );
  }
}

async function stop() {
  const running = client;
  client = undefined;
  if (running) await running.stop();
}

async function activate(context) {
  context.subscriptions.push(
    commands.registerCommand("antdsl.restart", async () => {
      await stop();
      await start();
    })
  );
  await start();
}

module.exports = { activate, deactivate: stop };

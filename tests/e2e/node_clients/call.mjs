// The TypeScript SDK's client, as hosts use it: it starts a server by a command, lists its tools, and calls one twice.
// Arguments: the server's command as JSON, the tool, and the arguments of both calls as JSON.
import { Client } from "@modelcontextprotocol/sdk/client/index.js";
import { StdioClientTransport } from "@modelcontextprotocol/sdk/client/stdio.js";

const [command, tool, calls] = process.argv.slice(2);
const client = new Client({ name: "host", version: "1" });
await client.connect(new StdioClientTransport(JSON.parse(command)));
const { tools } = await client.listTools();
const told = [];
for (const args of JSON.parse(calls)) told.push(await client.callTool({ name: tool, arguments: args }));
console.log(JSON.stringify({ tools: tools.map((each) => each.name), told }));
await client.close();

// The Foxglove protocol's reference client, which offers both names of the protocol as Lichtblick does: subscribes to every
// channel for a while and prints what came as JSON.
const { FoxgloveClient } = require("../../frontend/node_modules/@foxglove/ws-protocol");

const [url, seconds] = process.argv.slice(2);
const client = new FoxgloveClient({ ws: new WebSocket(url, ["foxglove.sdk.v1", FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const topics = new Map();
const said = { server: null, topics: {} };

client.on("error", (error) => {
  console.error(String(error.message ?? error));
  process.exit(1);
});
client.on("serverInfo", (info) => (said.server = info.name));
client.on("advertise", (channels) => {
  for (const channel of channels) {
    const { topic, encoding, schemaName, schema } = channel;
    said.topics[topic] = { encoding, schemaName, schema, messages: [] };
    topics.set(client.subscribe(channel.id), topic);
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const bytes = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  said.topics[topics.get(subscriptionId)].messages.push([String(timestamp), bytes.toString("base64")]);
});
setTimeout(() => {
  process.stdout.write(JSON.stringify(said), () => process.exit(0));
}, seconds * 1000);

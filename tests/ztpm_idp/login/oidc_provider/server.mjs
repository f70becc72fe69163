// The certified npm `oidc-provider` with one client: arguments are our callback's address and the client's secret.
import { createServer } from "node:http";
import Provider from "oidc-provider";

const [callback, secret] = process.argv.slice(2);
const server = createServer((request, response) => app(request, response));
let app;
server.listen(0, "127.0.0.1", () => {
  const issuer = `http://127.0.0.1:${server.address().port}`;
  const provider = new Provider(issuer, {
    clients: [
      {
        client_id: "ztpm",
        client_secret: secret,
        redirect_uris: [callback],
        response_types: ["code"],
        grant_types: ["authorization_code"],
        token_endpoint_auth_method: "client_secret_basic",
      },
    ],
    cookies: { keys: ["a key of a test"] },
  });
  app = provider.callback();
  console.log(issuer);
});

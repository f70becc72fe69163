// The certified npm `oidc-provider` for a public client whose tokens are bound, with a nonce wanted everywhere; the
// argument is the client's redirect address. Its userinfo endpoint is the resource.
import { createServer } from "node:http";
import { randomBytes } from "node:crypto";
import Provider from "oidc-provider";

const [redirect] = process.argv.slice(2);
const metadata = "/.well-known/oauth-protected-resource/me";
let app, issuer;
const server = createServer((request, response) => {
  if (request.url !== metadata) return app(request, response);
  response.setHeader("content-type", "application/json");
  response.end(JSON.stringify({ resource: `${issuer}/me`, authorization_servers: [issuer], scopes_supported: ["openid"] }));
});
server.listen(0, "127.0.0.1", () => {
  issuer = `http://127.0.0.1:${server.address().port}`;
  const provider = new Provider(issuer, {
    clients: [
      {
        client_id: "viewer",
        redirect_uris: [redirect],
        response_types: ["code"],
        grant_types: ["authorization_code", "refresh_token"],
        token_endpoint_auth_method: "none",
        application_type: "native",
        dpop_bound_access_tokens: true,
      },
    ],
    features: { resourceIndicators: { enabled: false }, dPoP: { enabled: true, nonceSecret: randomBytes(32), requireNonce: () => true } },
    issueRefreshToken: () => true,
    cookies: { keys: ["a key of a test"] },
  });
  app = provider.callback();
  console.log(issuer);
});

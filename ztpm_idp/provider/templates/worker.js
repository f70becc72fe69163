"use strict";
// The worker of the page of open questions: it shows what the provider pushes to this device, with no page open, and opens
// the question when the notification is pressed. It asks for nothing, keeps nothing, and stands before no request.
self.addEventListener("push", (event) => {
  const said = event.data.json();
  const options = { body: said.body, tag: said.tag, data: { url: said.url }, requireInteraction: true };
  event.waitUntil(self.registration.showNotification(said.title, options));
});

self.addEventListener("notificationclick", (event) => {
  event.notification.close();
  const url = new URL(event.notification.data.url);
  // A page of this provider, and of nobody else.
  if (url.origin === self.location.origin) event.waitUntil(self.clients.openWindow(url.href));
});

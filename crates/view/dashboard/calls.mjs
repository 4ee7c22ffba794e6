// Calls of the coordinator's services as JSON.
import { byId } from './words.mjs';

export async function call(service, method, request) {
  const answer = await fetch(`sightline.v1.${service}/${method}`, {
    method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify(request),
  });
  const value = await answer.json();
  if (!answer.ok) throw new Error(value.message ?? `${answer.status}`);
  return value;
}

// Returns the answer of an address, as JSON.
export async function get(address) {
  const answer = await fetch(address);
  const value = await answer.json();
  if (!answer.ok) throw new Error(value.message ?? `${answer.status}`);
  return value;
}

// Shows an error message, or hides the message if there is no text.
export function complain(text) {
  byId('message').hidden = !text;
  byId('message').textContent = text ?? '';
}

// Runs a function and shows the message of its error.
export async function attempt(work) {
  try {
    complain();
    return await work();
  } catch (e) {
    complain(e.message);
    return undefined;
  }
}

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

// The answer of an address, as JSON.
export async function get(address) {
  const answer = await fetch(address);
  const value = await answer.json();
  if (!answer.ok) throw new Error(value.message ?? `${answer.status}`);
  return value;
}

// Says what went wrong, or takes it back.
export function complain(text) {
  byId('message').hidden = !text;
  byId('message').textContent = text ?? '';
}

// Runs something and says what went wrong.
export async function attempt(work) {
  try {
    complain();
    return await work();
  } catch (e) {
    complain(e.message);
    return undefined;
  }
}

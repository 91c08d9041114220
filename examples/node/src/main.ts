// Steps environments and evaluates a policy; prints what came of it as one line of JSON.
//
//   node dist/main.js [--server localhost:7257] [--env hopper-w2] [--num-envs 4] [--steps 100]
//                     [--episodes 5] [--policy random]

import { parseArgs } from "node:util";
import { Client, PalrGymError } from "./client.js";

const { values } = parseArgs({
  options: {
    server: { type: "string", default: process.env["PALR_GYM_SERVER"] ?? "localhost:7257" },
    env: { type: "string", default: "hopper-w2" },
    "num-envs": { type: "string", default: "4" },
    steps: { type: "string", default: "100" },
    episodes: { type: "string", default: "5" },
    policy: { type: "string", default: "random" },
  },
});

/** An action that needs no random numbers: waves within the bounds. */
function wave(step: number, size: number): Float32Array {
  return Float32Array.from({ length: size }, (_, i) => ((step * 31 + i * 7) % 21) / 10 - 1);
}

async function main(): Promise<void> {
  const client = new Client(values.server);
  const session = await client.openSession({
    envId: values.env,
    numEnvs: Number(values["num-envs"]),
  });
  const size = session.numEnvs * (session.spec.actionSpace?.names.length ?? 0);

  let observations = await session.reset(0);
  const rewards: number[] = new Array(session.numEnvs).fill(0);
  let ended = 0;
  for (let step = 0; step < Number(values.steps); step++) {
    const result = await session.step(wave(step, size));
    observations = result.observations;
    result.rewards.forEach((reward, i) => (rewards[i]! += reward));
    ended += result.terminated.filter((terminated, i) => terminated || result.truncated[i]).length;
  }
  await session.close();

  const policy = values.policy === "expert" ? { expert: {} } : { random: {} };
  const evaluation = await client.evaluate({
    envId: values.env,
    policy,
    episodes: Number(values.episodes),
  });
  const returns = evaluation.episodes
    .sort((a, b) => a.index - b.index)
    .map((episode) => episode.episodeReturn);
  console.log(
    JSON.stringify({
      tasks: await client.tasks(),
      observations: Array.from(observations),
      rewards,
      ended,
      returns,
      scoreMean: evaluation.summary.scoreMean,
    }),
  );
  client.close();
}

main().catch((error: unknown) => {
  console.error(error instanceof PalrGymError ? `error: ${error.message}` : error);
  process.exitCode = 1;
});

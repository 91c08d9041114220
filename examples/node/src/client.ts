// A small client of palr-gym: sessions of environments, stepped over a stream, and evaluation.
//
// The types in ./generated come from proto/ (`npm run generate`); the messages themselves are
// encoded by @grpc/proto-loader from the same files.

import { once } from "node:events";
import { fileURLToPath } from "node:url";
import * as grpc from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";
import type { ProtoGrpcType as Environments } from "./generated/environment_service.js";
import type { ProtoGrpcType as Evaluations } from "./generated/evaluation_service.js";
import type { CloseSessionRequest } from "./generated/palr_gym/v1/CloseSessionRequest.js";
import type { CloseSessionResponse__Output } from "./generated/palr_gym/v1/CloseSessionResponse.js";
import type { EnvironmentServiceClient } from "./generated/palr_gym/v1/EnvironmentService.js";
import type { EnvironmentSpec__Output } from "./generated/palr_gym/v1/EnvironmentSpec.js";
import type { EpisodeResult__Output } from "./generated/palr_gym/v1/EpisodeResult.js";
import type { EvaluateRequest } from "./generated/palr_gym/v1/EvaluateRequest.js";
import type { EvaluateResponse__Output } from "./generated/palr_gym/v1/EvaluateResponse.js";
import type { EvaluationServiceClient } from "./generated/palr_gym/v1/EvaluationService.js";
import type { EvaluationSummary__Output } from "./generated/palr_gym/v1/EvaluationSummary.js";
import type { ListTasksRequest } from "./generated/palr_gym/v1/ListTasksRequest.js";
import type { ListTasksResponse__Output } from "./generated/palr_gym/v1/ListTasksResponse.js";
import type { OpenSessionRequest } from "./generated/palr_gym/v1/OpenSessionRequest.js";
import type { OpenSessionResponse__Output } from "./generated/palr_gym/v1/OpenSessionResponse.js";
import type { StepStreamRequest } from "./generated/palr_gym/v1/StepStreamRequest.js";
import type { StepStreamResponse__Output } from "./generated/palr_gym/v1/StepStreamResponse.js";
import type { Tensor__Output } from "./generated/palr_gym/v1/Tensor.js";

const PROTO = fileURLToPath(new URL("../../../proto", import.meta.url));
const FILES = ["palr_gym/v1/environment_service.proto", "palr_gym/v1/evaluation_service.proto"];
const DEADLINE_MS = 30_000;

const protocol = grpc.loadPackageDefinition(
  // As the types were generated: see "generate" in package.json.
  loadSync(FILES, {
    includeDirs: [PROTO],
    longs: String,
    enums: String,
    defaults: true,
    oneofs: true,
  }),
) as unknown as Environments & Evaluations;

/** A call that failed: gRPC's code, and what was wrong. */
export class PalrGymError extends Error {
  constructor(
    readonly code: grpc.status,
    message: string,
  ) {
    super(`${grpc.status[code]}: ${message}`);
    this.name = "PalrGymError";
  }
}

/** What a step of N environments returned; rows of environments one after the other. */
export interface StepResult {
  /** [N * observation size] */
  observations: Float64Array;
  /** [N] */
  rewards: Float64Array;
  /** [N]: the task ended the episode. */
  terminated: boolean[];
  /** [N]: the time limit ended the episode. */
  truncated: boolean[];
}

/** Episodes one by one, and what they come to. */
export interface Evaluation {
  episodes: EpisodeResult__Output[];
  summary: EvaluationSummary__Output;
}

/** A connection to one server. */
export class Client {
  readonly #environments: EnvironmentServiceClient;
  readonly #evaluations: EvaluationServiceClient;

  /** `server`: host:port or unix:path. Opens no socket before the first call. */
  constructor(server: string) {
    const { v1 } = protocol.palr_gym;
    const credentials = grpc.credentials.createInsecure();
    // A session of many environments is larger than grpc's 4 MiB.
    const options = { "grpc.max_receive_message_length": -1 };
    this.#environments = new v1.EnvironmentService(server, credentials, options);
    this.#evaluations = new v1.EvaluationService(server, credentials, options);
  }

  /** Names of the tasks that the server hosts. */
  async tasks(): Promise<string[]> {
    const list = this.#environments.listTasks.bind(this.#environments);
    const answer = await unary<ListTasksRequest, ListTasksResponse__Output>(list, {});
    return answer.tasks.map((task) => task.name);
  }

  /** Opens environments to step. */
  async openSession(request: OpenSessionRequest): Promise<Session> {
    const open = this.#environments.openSession.bind(this.#environments);
    return new Session(
      this.#environments,
      await unary<OpenSessionRequest, OpenSessionResponse__Output>(open, request),
    );
  }

  /** Plays whole episodes on the server. */
  async evaluate(request: EvaluateRequest): Promise<Evaluation> {
    const episodes: EpisodeResult__Output[] = [];
    const call = this.#evaluations.evaluate(request);
    try {
      for await (const message of call as AsyncIterable<EvaluateResponse__Output>) {
        if (message.episode) episodes.push(message.episode);
        if (message.summary) return { episodes, summary: message.summary };
      }
    } catch (error) {
      throw failure(error);
    }
    throw new PalrGymError(grpc.status.DATA_LOSS, "the evaluation ended without a summary");
  }

  /** Closes the connection. Sessions are not closed by this. */
  close(): void {
    this.#environments.close();
    this.#evaluations.close();
  }
}

/** N environments on a server. `Client.openSession` makes them. */
export class Session {
  readonly id: string;
  readonly spec: EnvironmentSpec__Output;
  readonly numEnvs: number;
  readonly #service: EnvironmentServiceClient;
  readonly #stream: grpc.ClientDuplexStream<StepStreamRequest, StepStreamResponse__Output>;
  readonly #answers: AsyncIterator<StepStreamResponse__Output>;

  constructor(service: EnvironmentServiceClient, opened: OpenSessionResponse__Output) {
    if (!opened.spec) throw new PalrGymError(grpc.status.INTERNAL, "a session without a spec");
    this.id = opened.sessionId;
    this.spec = opened.spec;
    this.numEnvs = opened.numEnvs;
    this.#service = service;
    this.#stream = service.stepStream();
    this.#answers = this.#stream[Symbol.asyncIterator]();
  }

  /** Starts new episodes, environment i from seed + i; returns [N * observation size]. */
  async reset(seed: number | bigint): Promise<Float64Array> {
    const reset = { sessionId: this.id, seeds: [seed.toString()] };
    const answer = await this.#ask({ reset });
    return float64(answer.reset?.observations);
  }

  /** Steps every environment with its row of `actions`, [N * action size]. */
  async step(actions: Float32Array): Promise<StepResult> {
    const data = new Uint8Array(actions.buffer, actions.byteOffset, actions.byteLength);
    const shape = [this.numEnvs, actions.length / this.numEnvs];
    const tensor = { dtype: "DATA_TYPE_FLOAT32", shape, data } as const;
    const { step } = await this.#ask({ step: { sessionId: this.id, actions: tensor } });
    return {
      observations: float64(step?.observations),
      rewards: float64(step?.rewards),
      terminated: boolean(step?.terminated),
      truncated: boolean(step?.truncated),
    };
  }

  /** Closes the session on the server. */
  async close(): Promise<void> {
    this.#stream.end();
    const close = this.#service.closeSession.bind(this.#service);
    await unary<CloseSessionRequest, CloseSessionResponse__Output>(close, { sessionId: this.id });
  }

  async #ask(request: StepStreamRequest): Promise<StepStreamResponse__Output> {
    // The stream has no deadline of its own: a server that says nothing is given up.
    const timer = setTimeout(() => this.#stream.cancel(), DEADLINE_MS);
    try {
      if (!this.#stream.write(request)) await once(this.#stream, "drain");
      const { value, done } = await this.#answers.next();
      if (done) throw new PalrGymError(grpc.status.UNAVAILABLE, "the server ended the stream");
      if (value.error) throw new PalrGymError(value.error.code, value.error.message);
      return value;
    } catch (error) {
      throw failure(error);
    } finally {
      clearTimeout(timer);
    }
  }
}

type Unary<Request, Response> = (
  request: Request,
  options: grpc.CallOptions,
  callback: (error: grpc.ServiceError | null, response?: Response) => void,
) => unknown;

function unary<Request, Response>(
  method: Unary<Request, Response>,
  request: Request,
): Promise<Response> {
  return new Promise((resolve, reject) => {
    method(request, { deadline: Date.now() + DEADLINE_MS }, (error, response) => {
      if (response === undefined) reject(failure(error));
      else resolve(response);
    });
  });
}

function failure(error: unknown): unknown {
  if (error instanceof Error && "code" in error && "details" in error) {
    // grpc-js leaves the escapes of reserved characters, such as %3F, in a message.
    const text = String(error.details).replace(/%(2[3468BCF]|3[ABDF]|40)/gi, decodeURIComponent);
    return new PalrGymError(error.code as grpc.status, text);
  }
  return error;
}

// Elements are little-endian, as on every machine that Node.js runs on but s390x.

function float64(tensor: Tensor__Output | null | undefined): Float64Array {
  if (tensor?.dtype !== "DATA_TYPE_FLOAT64") {
    throw new PalrGymError(grpc.status.INTERNAL, `expected float64, got ${tensor?.dtype}`);
  }
  // A copy: in the message the elements stand at any address.
  return new Float64Array(Uint8Array.from(tensor.data).buffer);
}

function boolean(tensor: Tensor__Output | null | undefined): boolean[] {
  if (tensor?.dtype !== "DATA_TYPE_BOOL") {
    throw new PalrGymError(grpc.status.INTERNAL, `expected bool, got ${tensor?.dtype}`);
  }
  return Array.from(tensor.data, (byte) => byte !== 0);
}

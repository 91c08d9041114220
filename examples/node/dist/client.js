// A small client of palr-gym: sessions of environments, stepped over a stream, and evaluation.
//
// The types in ./generated come from proto/ (`npm run generate`); the messages themselves are
// encoded by @grpc/proto-loader from the same files.
import { once } from "node:events";
import { fileURLToPath } from "node:url";
import * as grpc from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";
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
}));
/** A call that failed: gRPC's code, and what was wrong. */
export class PalrGymError extends Error {
    code;
    constructor(code, message) {
        super(`${grpc.status[code]}: ${message}`);
        this.code = code;
        this.name = "PalrGymError";
    }
}
/** A connection to one server. */
export class Client {
    #environments;
    #evaluations;
    /** `server`: host:port or unix:path. Opens no socket before the first call. */
    constructor(server) {
        const { v1 } = protocol.palr_gym;
        const credentials = grpc.credentials.createInsecure();
        // A session of many environments is larger than grpc's 4 MiB.
        const options = { "grpc.max_receive_message_length": -1 };
        this.#environments = new v1.EnvironmentService(server, credentials, options);
        this.#evaluations = new v1.EvaluationService(server, credentials, options);
    }
    /** Names of the tasks that the server hosts. */
    async tasks() {
        const list = this.#environments.listTasks.bind(this.#environments);
        const answer = await unary(list, {});
        return answer.tasks.map((task) => task.name);
    }
    /** Opens environments to step. */
    async openSession(request) {
        const open = this.#environments.openSession.bind(this.#environments);
        return new Session(this.#environments, await unary(open, request));
    }
    /** Plays whole episodes on the server. */
    async evaluate(request) {
        const episodes = [];
        const call = this.#evaluations.evaluate(request);
        try {
            for await (const message of call) {
                if (message.episode)
                    episodes.push(message.episode);
                if (message.summary)
                    return { episodes, summary: message.summary };
            }
        }
        catch (error) {
            throw failure(error);
        }
        throw new PalrGymError(grpc.status.DATA_LOSS, "the evaluation ended without a summary");
    }
    /** Closes the connection. Sessions are not closed by this. */
    close() {
        this.#environments.close();
        this.#evaluations.close();
    }
}
/** N environments on a server. `Client.openSession` makes them. */
export class Session {
    id;
    spec;
    numEnvs;
    #service;
    #stream;
    #answers;
    constructor(service, opened) {
        if (!opened.spec)
            throw new PalrGymError(grpc.status.INTERNAL, "a session without a spec");
        this.id = opened.sessionId;
        this.spec = opened.spec;
        this.numEnvs = opened.numEnvs;
        this.#service = service;
        this.#stream = service.stepStream();
        this.#answers = this.#stream[Symbol.asyncIterator]();
    }
    /** Starts new episodes, environment i from seed + i; returns [N * observation size]. */
    async reset(seed) {
        const reset = { sessionId: this.id, seeds: [seed.toString()] };
        const answer = await this.#ask({ reset });
        return float64(answer.reset?.observations);
    }
    /** Steps every environment with its row of `actions`, [N * action size]. */
    async step(actions) {
        const data = new Uint8Array(actions.buffer, actions.byteOffset, actions.byteLength);
        const shape = [this.numEnvs, actions.length / this.numEnvs];
        const tensor = { dtype: "DATA_TYPE_FLOAT32", shape, data };
        const { step } = await this.#ask({ step: { sessionId: this.id, actions: tensor } });
        return {
            observations: float64(step?.observations),
            rewards: float64(step?.rewards),
            terminated: boolean(step?.terminated),
            truncated: boolean(step?.truncated),
        };
    }
    /** Closes the session on the server. */
    async close() {
        this.#stream.end();
        const close = this.#service.closeSession.bind(this.#service);
        await unary(close, { sessionId: this.id });
    }
    async #ask(request) {
        // The stream has no deadline of its own: a server that says nothing is given up.
        const timer = setTimeout(() => this.#stream.cancel(), DEADLINE_MS);
        try {
            if (!this.#stream.write(request))
                await once(this.#stream, "drain");
            const { value, done } = await this.#answers.next();
            if (done)
                throw new PalrGymError(grpc.status.UNAVAILABLE, "the server ended the stream");
            if (value.error)
                throw new PalrGymError(value.error.code, value.error.message);
            return value;
        }
        catch (error) {
            throw failure(error);
        }
        finally {
            clearTimeout(timer);
        }
    }
}
function unary(method, request) {
    return new Promise((resolve, reject) => {
        method(request, { deadline: Date.now() + DEADLINE_MS }, (error, response) => {
            if (response === undefined)
                reject(failure(error));
            else
                resolve(response);
        });
    });
}
function failure(error) {
    if (error instanceof Error && "code" in error && "details" in error) {
        // grpc-js leaves the escapes of reserved characters, such as %3F, in a message.
        const text = String(error.details).replace(/%(2[3468BCF]|3[ABDF]|40)/gi, decodeURIComponent);
        return new PalrGymError(error.code, text);
    }
    return error;
}
// Elements are little-endian, as on every machine that Node.js runs on but s390x.
function float64(tensor) {
    if (tensor?.dtype !== "DATA_TYPE_FLOAT64") {
        throw new PalrGymError(grpc.status.INTERNAL, `expected float64, got ${tensor?.dtype}`);
    }
    // A copy: in the message the elements stand at any address.
    return new Float64Array(Uint8Array.from(tensor.data).buffer);
}
function boolean(tensor) {
    if (tensor?.dtype !== "DATA_TYPE_BOOL") {
        throw new PalrGymError(grpc.status.INTERNAL, `expected bool, got ${tensor?.dtype}`);
    }
    return Array.from(tensor.data, (byte) => byte !== 0);
}

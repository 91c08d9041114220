//! A server that steps nothing: tonic, our messages, and answers of the right size that were made
//! beforehand. What is left is what a round trip costs.

use std::path::PathBuf;
use std::pin::Pin;

use bytes::Bytes;
use clap::Parser;
use futures_util::{Stream, StreamExt};
use palr_gym_bench::report;
use palr_gym_proto::v1;
use palr_gym_proto::v1::environment_service_server::{
    EnvironmentService, EnvironmentServiceServer,
};
use palr_gym_proto::v1::step_stream_request::Request as StreamRequest;
use palr_gym_proto::v1::step_stream_response::Response as StreamResponse;
use palr_gym_sim::resolve;
use serde::Serialize;
use tokio::net::UnixListener;
use tokio_stream::wrappers::UnixListenerStream;
use tonic::{Request, Response, Status, Streaming, async_trait};

#[derive(Debug, Parser)]
#[command(about = "Answers steps without taking any")]
struct Cli {
    /// Task whose messages are answered.
    #[arg(long)]
    task: String,
    /// Socket to listen on.
    #[arg(long)]
    unix: PathBuf,
}

#[derive(Debug, Serialize)]
struct Ready {
    unix: String,
}

/// As long as an id of ours.
const SESSION_ID: &str = "00000000-0000-0000-0000-000000000000";

/// Sizes of the task's messages.
struct Echo {
    observation_size: usize,
    action_size: usize,
    info_size: usize,
}

fn tensor(dtype: v1::DataType, element_bytes: usize, shape: &[usize]) -> v1::Tensor {
    let count: usize = shape.iter().product();
    v1::Tensor {
        dtype: dtype.into(),
        shape: shape.iter().map(|&size| size as i64).collect(),
        data: Bytes::from(vec![0; count * element_bytes]),
    }
}

impl Echo {
    fn reset_answer(&self) -> v1::ResetResponse {
        let shape = [1, self.observation_size];
        v1::ResetResponse {
            observations: Some(tensor(v1::DataType::Float64, 8, &shape)),
            info: None,
        }
    }

    fn step_answer(&self) -> v1::StepResponse {
        let float64 = |shape: &[usize]| Some(tensor(v1::DataType::Float64, 8, shape));
        let boolean = |shape: &[usize]| Some(tensor(v1::DataType::Bool, 1, shape));
        v1::StepResponse {
            observations: float64(&[1, self.observation_size]),
            rewards: float64(&[1]),
            terminated: boolean(&[1]),
            truncated: boolean(&[1]),
            info: float64(&[1, self.info_size]),
            ..v1::StepResponse::default()
        }
    }
}

fn not_here<T>() -> Result<Response<T>, Status> {
    Err(Status::unimplemented("this server only echoes"))
}

#[async_trait]
impl EnvironmentService for Echo {
    async fn open_session(
        &self,
        _: Request<v1::OpenSessionRequest>,
    ) -> Result<Response<v1::OpenSessionResponse>, Status> {
        let spec = v1::EnvironmentSpec {
            action_space: Some(v1::BoxSpace {
                shape: vec![self.action_size as i64],
                ..v1::BoxSpace::default()
            }),
            ..v1::EnvironmentSpec::default()
        };
        Ok(Response::new(v1::OpenSessionResponse {
            session_id: SESSION_ID.into(),
            spec: Some(spec),
            num_envs: 1,
            idle_limit_s: 600,
        }))
    }

    async fn close_session(
        &self,
        _: Request<v1::CloseSessionRequest>,
    ) -> Result<Response<v1::CloseSessionResponse>, Status> {
        Ok(Response::new(v1::CloseSessionResponse {}))
    }

    type StepStreamStream =
        Pin<Box<dyn Stream<Item = Result<v1::StepStreamResponse, Status>> + Send>>;

    async fn step_stream(
        &self,
        request: Request<Streaming<v1::StepStreamRequest>>,
    ) -> Result<Response<Self::StepStreamStream>, Status> {
        let (reset, step) = (self.reset_answer(), self.step_answer());
        let answers = request.into_inner().map(move |request| {
            let response = match request?.request {
                Some(StreamRequest::Step(_)) => StreamResponse::Step(step.clone()),
                _ => StreamResponse::Reset(reset.clone()),
            };
            Ok(v1::StepStreamResponse { response: Some(response) })
        });
        Ok(Response::new(Box::pin(answers)))
    }

    async fn list_tasks(
        &self,
        _: Request<v1::ListTasksRequest>,
    ) -> Result<Response<v1::ListTasksResponse>, Status> {
        not_here()
    }

    async fn get_environment_spec(
        &self,
        _: Request<v1::GetEnvironmentSpecRequest>,
    ) -> Result<Response<v1::GetEnvironmentSpecResponse>, Status> {
        not_here()
    }

    async fn reset(
        &self,
        _: Request<v1::ResetRequest>,
    ) -> Result<Response<v1::ResetResponse>, Status> {
        not_here()
    }

    async fn step(
        &self,
        _: Request<v1::StepRequest>,
    ) -> Result<Response<v1::StepResponse>, Status> {
        not_here()
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    let (task, spec) = resolve(&cli.task)?;
    let echo = Echo {
        observation_size: spec.observation_size(),
        action_size: spec.action_size(),
        info_size: task.spec().info_names.len(),
    };
    let incoming = UnixListenerStream::new(UnixListener::bind(&cli.unix)?);
    report(&Ready { unix: cli.unix.display().to_string() })?;
    tonic::transport::Server::builder()
        .add_service(EnvironmentServiceServer::new(echo))
        .serve_with_incoming(incoming)
        .await?;
    Ok(())
}

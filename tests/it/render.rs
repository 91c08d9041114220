//! Pictures through the wire.

use palr_gym_proto::v1;
use palr_gym_proto::v1::render_service_client::RenderServiceClient;
use palr_gym_server::ServerConfig;
use palr_gym_sim::render::GlChoice;
use palr_gym_trainer::session::Session;
use tonic::Code;

use crate::support::{TestServer, open};

fn request(session: &Session) -> v1::RenderRequest {
    v1::RenderRequest {
        session_id: session.id().to_owned(),
        width_px: Some(64),
        height_px: Some(32),
        format: v1::ImageFormat::RawRgb.into(),
        ..v1::RenderRequest::default()
    }
}

#[tokio::test]
async fn pictures_are_the_same_whatever_the_number_of_threads_and_environments() {
    let mut seen: Vec<Vec<u8>> = Vec::new();
    for (threads, num_envs) in [(1, 1), (3, 3)] {
        let config = ServerConfig { simulation_threads: threads, ..ServerConfig::default() };
        let server = TestServer::start(config).await;
        let mut renders = RenderServiceClient::new(server.channel().await);
        let mut session =
            Session::open(&server.client().await, open("lane", num_envs)).await.unwrap();
        session.reset(vec![7]).await.unwrap();
        for _ in 0..5 {
            session.step(&[0.5, 0.1].repeat(num_envs as usize)).await.unwrap();
        }
        let answer = renders.render(request(&session)).await.unwrap().into_inner();
        let tensor = answer.rgb.unwrap();
        assert_eq!(tensor.shape, [i64::from(num_envs), 32, 64, 3]);
        assert_eq!(tensor.dtype(), v1::DataType::Uint8);
        assert_eq!(tensor.data.len(), num_envs as usize * 32 * 64 * 3);
        seen.push(tensor.data[..32 * 64 * 3].to_vec());
        if num_envs > 1 {
            let one = v1::RenderRequest { env_indices: vec![2], ..request(&session) };
            let one = renders.render(one).await.unwrap().into_inner().rgb.unwrap();
            assert_eq!(one.data[..], tensor.data[2 * 32 * 64 * 3..]);
            assert_ne!(one.data[..], tensor.data[..32 * 64 * 3]);
        }
        let png = v1::RenderRequest { format: 0, camera: "top".into(), ..request(&session) };
        let answer = renders.render(png).await.unwrap().into_inner();
        assert_eq!((answer.png.len(), answer.rgb), (num_envs as usize, None));
        assert!(answer.png.iter().all(|file| file.starts_with(b"\x89PNG\r\n\x1a\n")));
    }
    assert!(seen[0] == seen[1]);
}

#[tokio::test]
async fn what_cannot_be_drawn_is_refused_by_field_and_reason() {
    let server = TestServer::start(ServerConfig::default()).await;
    let mut renders = RenderServiceClient::new(server.channel().await);
    let mut session = Session::open(&server.client().await, open("hopper", 2)).await.unwrap();
    session.reset(vec![0]).await.unwrap();
    let good = request(&session);
    for (wrong, code, expected) in [
        (
            v1::RenderRequest { session_id: "x".into(), ..good.clone() },
            Code::NotFound,
            "session \"x\" not found",
        ),
        (
            v1::RenderRequest { camera: "driver".into(), ..good.clone() },
            Code::InvalidArgument,
            "no camera \"driver\"; expected track",
        ),
        (
            v1::RenderRequest { width_px: Some(0), ..good.clone() },
            Code::InvalidArgument,
            "0 x 32 pixels; expected 1 to 2048 each way",
        ),
        (
            v1::RenderRequest { height_px: Some(10_000), ..good.clone() },
            Code::InvalidArgument,
            "64 x 10000 pixels",
        ),
        (
            v1::RenderRequest {
                width_px: Some(u32::MAX),
                height_px: Some(u32::MAX),
                ..good.clone()
            },
            Code::InvalidArgument,
            "ask for fewer or smaller ones",
        ),
        (
            v1::RenderRequest { env_indices: vec![1, 1], ..good.clone() },
            Code::InvalidArgument,
            "environment index 1 after Some(1)",
        ),
        (
            v1::RenderRequest { env_indices: vec![2], ..good.clone() },
            Code::InvalidArgument,
            "expected ascending indices below 2",
        ),
        (v1::RenderRequest { format: 9, ..good.clone() }, Code::InvalidArgument, "format is 9"),
    ] {
        let status = renders.render(wrong).await.unwrap_err();
        assert_eq!(status.code(), code, "{status}");
        assert!(status.message().contains(expected), "{status}");
    }
    assert!(renders.render(good).await.is_ok());
}

#[tokio::test]
async fn a_server_that_draws_nothing_does_everything_else() {
    let config = ServerConfig { gl: GlChoice::None, ..ServerConfig::default() };
    let server = TestServer::start(config).await;
    let mut renders = RenderServiceClient::new(server.channel().await);
    let mut session = Session::open(&server.client().await, open("lane", 1)).await.unwrap();
    session.reset(vec![0]).await.unwrap();
    let status = renders.render(request(&session)).await.unwrap_err();
    assert_eq!(status.code(), Code::FailedPrecondition);
    assert!(status.message().contains("--gl auto"), "{status}");
    session.step(&[0.5, 0.0]).await.unwrap();
}

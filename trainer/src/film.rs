//! Pictures of an episode, one for each step.

use bytes::Bytes;
use palr_gym_core::ActionMode;
use palr_gym_proto::v1;
use palr_gym_proto::v1::collect_response::Response;

use crate::client::Client;
use crate::error::ClientError;
use crate::evaluate::wire_action_mode;
use crate::policy::PolicySource;
use crate::session::Session;

/// How to look.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Look {
    /// One of the environment's cameras; empty: the first.
    pub camera: String,
    /// Pixels across.
    pub width_px: u32,
    /// Pixels down.
    pub height_px: u32,
}

/// What to film.
#[derive(Debug, Clone)]
pub struct FilmOptions {
    /// Such as `lane`.
    pub env_id: String,
    /// Who plays.
    pub policy: PolicySource,
    /// Of the episode.
    pub seed: u64,
    /// Deterministic or sampled actions.
    pub action_mode: ActionMode,
    /// Of a driving task; the defaults if unset.
    pub scene_options: Option<v1::SceneOptions>,
    /// Steps at most; all of the episode's if unset.
    pub steps: Option<usize>,
    /// How to look.
    pub look: Look,
}

/// A picture, `[height, width, 3]`.
pub type Frame = Bytes;

/// Draws what environment `env_index` of any session looks like now.
///
/// # Errors
/// [`ClientError::Status`].
pub async fn picture(
    client: &Client,
    session_id: &str,
    env_index: u32,
    look: &Look,
) -> Result<Frame, ClientError> {
    let request = v1::RenderRequest {
        session_id: session_id.to_owned(),
        env_indices: vec![env_index],
        camera: look.camera.clone(),
        width_px: Some(look.width_px),
        height_px: Some(look.height_px),
        format: v1::ImageFormat::RawRgb.into(),
    };
    let mut service = client.renders();
    let answer = client.within(service.render(request)).await?.into_inner();
    let frame = answer.rgb.map(|tensor| tensor.data).unwrap_or_default();
    if frame.len() != look.width_px as usize * look.height_px as usize * 3 {
        return Err(ClientError::Protocol("a picture of another size than asked for".into()));
    }
    Ok(frame)
}

/// Plays an episode on the server, and plays its actions again in a session that is drawn: the same
/// seed and actions lead to the same episode. `on_frame` gets the reset's picture and then one for
/// each step; its error ends the film.
///
/// # Errors
/// [`ClientError`] of the first call that fails.
pub async fn film(
    client: &Client,
    options: &FilmOptions,
    mut on_frame: impl FnMut(Frame) -> Result<(), ClientError>,
) -> Result<(), ClientError> {
    let actions = episode_actions(client, options).await?;
    let request = v1::OpenSessionRequest {
        env_id: options.env_id.clone(),
        autoreset_mode: v1::AutoresetMode::Disabled.into(),
        scene_options: options.scene_options,
        ..v1::OpenSessionRequest::default()
    };
    let mut session = Session::open(client, request).await?;
    let filmed = play(client, &mut session, options, &actions, &mut on_frame).await;
    let closed = session.close().await;
    filmed.and(closed)
}

async fn play(
    client: &Client,
    session: &mut Session,
    options: &FilmOptions,
    actions: &[f32],
    on_frame: &mut impl FnMut(Frame) -> Result<(), ClientError>,
) -> Result<(), ClientError> {
    session.reset(vec![options.seed]).await?;
    let id = session.id().to_owned();
    on_frame(picture(client, &id, 0, &options.look).await?)?;
    let size = session.spec().action_space.as_ref().map_or(1, |space| space.names.len());
    let steps = options.steps.unwrap_or(usize::MAX);
    for action in actions.chunks_exact(size.max(1)).take(steps) {
        session.step(action).await?;
        on_frame(picture(client, &id, 0, &options.look).await?)?;
    }
    Ok(())
}

/// The actions of the policy's first episode.
async fn episode_actions(client: &Client, options: &FilmOptions) -> Result<Vec<f32>, ClientError> {
    let request = v1::CollectRequest {
        env_id: options.env_id.clone(),
        policy: Some(options.policy.load()?),
        amount: Some(v1::collect_request::Amount::Episodes(1)),
        seed: options.seed,
        action_mode: wire_action_mode(options.action_mode).into(),
        num_envs: Some(1),
        first_episode: 0,
        scene_options: options.scene_options,
    };
    let mut service = client.collections();
    let mut stream = client.within(service.collect(request)).await?.into_inner();
    while let Some(message) = client.within(stream.message()).await? {
        if let Some(Response::Episode(episode)) = message.response {
            let data = episode.actions.map(|tensor| tensor.data).unwrap_or_default();
            return Ok(bytemuck::allocation::pod_collect_to_vec(&data));
        }
    }
    Err(ClientError::Protocol("no episode in the answer".into()))
}

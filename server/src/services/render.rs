//! `RenderService`.

use palr_gym_proto::v1::render_service_server::RenderService;
use palr_gym_proto::v1::{RenderRequest, RenderResponse};
use tonic::{Request, Response, Status, async_trait};

use super::Services;
use super::environment::{keep, mismatch};
use crate::convert;
use crate::encode::WireAnswer;
use crate::error::ServerError;
use crate::pictures::PictureOrder;
use crate::session::Command;

/// Where the caller does not say.
const DEFAULT_SIDE_PX: u32 = 480;

#[async_trait]
impl RenderService for Services {
    async fn render(
        &self,
        request: Request<RenderRequest>,
    ) -> Result<Response<RenderResponse>, Status> {
        let request = request.into_inner();
        let session = self.sessions.get(&request.session_id)?;
        let order = PictureOrder {
            gl: self.gl,
            env_indices: request.env_indices.iter().map(|&index| index as usize).collect(),
            camera: request.camera,
            width_px: request.width_px.unwrap_or(DEFAULT_SIDE_PX),
            height_px: request.height_px.unwrap_or(DEFAULT_SIDE_PX),
            format: convert::image_format(request.format)?,
        };
        let (got, max) = (order.bytes(session.num_envs()), self.limits.max_answer_bytes);
        if got > max {
            return Err(ServerError::PicturesTooLarge { got, max }.into());
        }
        match keep(session.submit(Command::Draw { order })).await? {
            WireAnswer::Pictures(answer) => Ok(Response::new(answer)),
            _ => Err(mismatch().into()),
        }
    }
}

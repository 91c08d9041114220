//! A connection that cannot be held for nothing: it must begin to speak, and it ends when the
//! server says so.

use std::io::{Error, ErrorKind, Result};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use futures_util::{Stream, StreamExt};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Sleep, sleep};
use tokio_util::sync::{CancellationToken, WaitForCancellationFutureOwned};
use tonic::transport::server::Connected;

use crate::services::guard::Admission;

/// A client that has not sent HTTP/2's preface by then is no client.
const PREFACE_DEADLINE: Duration = Duration::from_secs(10);
const PREFACE_BYTES: usize = 24;
/// Connections beyond the limit that are still told why they are refused.
const REFUSED_CONNECTIONS: usize = 64;

/// Lets connections in, up to a limit. Clones share it.
#[derive(Clone)]
pub(super) struct Admissions {
    admitted: Arc<Semaphore>,
    refused: Arc<Semaphore>,
    hang_up: CancellationToken,
}

/// A connection, with its place among the others.
pub(super) struct Connection<IO> {
    io: IO,
    admission: Admission,
    preface_left: usize,
    preface_deadline: Pin<Box<Sleep>>,
    hang_up: Pin<Box<WaitForCancellationFutureOwned>>,
    _place: OwnedSemaphorePermit,
}

impl Admissions {
    /// At most `max_connections`; all of them end when `hang_up` is cancelled.
    pub(super) fn new(max_connections: usize, hang_up: CancellationToken) -> Self {
        let semaphore = |places| Arc::new(Semaphore::new(places));
        Self {
            admitted: semaphore(max_connections.min(Semaphore::MAX_PERMITS)),
            refused: semaphore(REFUSED_CONNECTIONS),
            hang_up,
        }
    }

    /// Connections from `incoming`, each with a place. Those without one are closed.
    pub(super) fn admit<IO>(
        self,
        incoming: impl Stream<Item = Result<IO>> + Send,
    ) -> impl Stream<Item = Result<Connection<IO>>> + Send
    where
        IO: Send,
    {
        incoming.filter_map(move |io| {
            let connection = io.map(|io| self.place(io)).transpose();
            std::future::ready(connection)
        })
    }

    fn place<IO>(&self, io: IO) -> Option<Connection<IO>> {
        let admitted = Arc::clone(&self.admitted).try_acquire_owned().ok();
        let admission = Admission { is_refused: admitted.is_none() };
        let place = admitted.or_else(|| Arc::clone(&self.refused).try_acquire_owned().ok())?;
        Some(Connection {
            io,
            admission,
            preface_left: PREFACE_BYTES,
            preface_deadline: Box::pin(sleep(PREFACE_DEADLINE)),
            hang_up: Box::pin(self.hang_up.clone().cancelled_owned()),
            _place: place,
        })
    }
}

impl<IO: AsyncRead + Unpin> AsyncRead for Connection<IO> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        // Whoever serves a connection is always reading from it, so this is where it can be ended.
        if self.hang_up.as_mut().poll(context).is_ready() {
            return Poll::Ready(Err(Error::new(ErrorKind::ConnectionAborted, "shut down")));
        }
        let before = buffer.filled().len();
        let read = Pin::new(&mut self.io).poll_read(context, buffer);
        if self.preface_left > 0 {
            let got = buffer.filled().len() - before;
            self.preface_left = self.preface_left.saturating_sub(got);
            if self.preface_left > 0 && self.preface_deadline.as_mut().poll(context).is_ready() {
                return Poll::Ready(Err(Error::new(ErrorKind::TimedOut, "no HTTP/2 preface")));
            }
        }
        read
    }
}

impl<IO: AsyncWrite + Unpin> AsyncWrite for Connection<IO> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.io).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.io).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[std::io::IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        Pin::new(&mut self.io).poll_write_vectored(context, slices)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }
}

impl<IO> Connected for Connection<IO> {
    type ConnectInfo = Admission;

    fn connect_info(&self) -> Admission {
        self.admission
    }
}

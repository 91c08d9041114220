//! What stands before every service: refusals for lack of room, and a bound on what arrives.
//!
//! A message is in memory from its first byte, and its sender alone decides when the last one
//! comes. So the sizes of all messages that are arriving together are bounded, and so is the time
//! that each may take. What has arrived whole is bounded by the services.

use std::future::{Ready, ready};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use futures_util::future::Either;
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::time::{Sleep, sleep};
use tonic::Status;
use tonic::body::Body;
use tower::{Layer, Service};

use crate::error::ServerError;

/// Messages up to this size are not counted: there cannot be more of them than streams.
const SMALL_BYTES: usize = 64 << 10;
/// Length of a gRPC message's prefix: a flag, and the size in four bytes.
const PREFIX_BYTES: usize = 5;

/// Whether a connection has a place.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Admission {
    /// It has none: every call on it is refused.
    pub(crate) is_refused: bool,
}

/// Puts a [`Guard`] before a service. Clones share the bound.
#[derive(Debug, Clone)]
pub(crate) struct GuardLayer {
    arriving: Arc<Arriving>,
}

/// What is arriving, and how much may.
#[derive(Debug)]
struct Arriving {
    bytes: AtomicUsize,
    max_bytes: usize,
    deadline: Duration,
}

impl GuardLayer {
    /// At most `max_bytes` in messages that are not small and have not arrived whole, each of them
    /// for at most `deadline`.
    #[must_use]
    pub(crate) fn new(max_bytes: usize, deadline: Duration) -> Self {
        Self { arriving: Arc::new(Arriving { bytes: AtomicUsize::new(0), max_bytes, deadline }) }
    }
}

impl<S> Layer<S> for GuardLayer {
    type Service = Guard<S>;

    fn layer(&self, inner: S) -> Guard<S> {
        Guard { inner, arriving: Arc::clone(&self.arriving) }
    }
}

/// A service behind its guard.
#[derive(Debug, Clone)]
pub(crate) struct Guard<S> {
    inner: S,
    arriving: Arc<Arriving>,
}

impl<S> Service<http::Request<Body>> for Guard<S>
where
    S: Service<http::Request<Body>, Response = http::Response<Body>>,
{
    type Response = S::Response;
    type Error = S::Error;
    type Future = Either<Ready<Result<S::Response, S::Error>>, S::Future>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), S::Error>> {
        self.inner.poll_ready(context)
    }

    fn call(&mut self, request: http::Request<Body>) -> Self::Future {
        let admission = request.extensions().get::<Admission>();
        if admission.is_some_and(|admission| admission.is_refused) {
            let status = Status::from(ServerError::TooManyConnections);
            return Either::Left(ready(Ok(status.into_http())));
        }
        let arriving = Arc::clone(&self.arriving);
        let kind = Kind::of(request.uri().path());
        let request = request.map(|body| Body::new(Counted::new(body, kind, arriving)));
        Either::Right(self.inner.call(request))
    }
}

/// How the messages of a call come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// One, which is in memory until the call is complete.
    Single,
    /// Many, each handed on as it comes; in between there may be any time.
    Stream,
}

impl Kind {
    fn of(path: &str) -> Self {
        let is_stream = ["/StepStream", "/Process", "/ServerReflectionInfo"]
            .iter()
            .any(|method| path.ends_with(method));
        if is_stream { Self::Stream } else { Self::Single }
    }
}

/// A request's body that counts the message which is arriving in it.
struct Counted {
    body: Body,
    kind: Kind,
    arriving: Arc<Arriving>,
    prefix: [u8; PREFIX_BYTES],
    prefix_bytes: usize,
    /// Of the message whose prefix is complete.
    left: usize,
    /// What of it stands in `arriving`.
    counted: usize,
    deadline: Option<Pin<Box<Sleep>>>,
}

impl Counted {
    fn new(body: Body, kind: Kind, arriving: Arc<Arriving>) -> Self {
        Self {
            body,
            kind,
            deadline: (kind == Kind::Single).then(|| Box::pin(sleep(arriving.deadline))),
            arriving,
            prefix: [0; PREFIX_BYTES],
            prefix_bytes: 0,
            left: 0,
            counted: 0,
        }
    }

    /// Follows the messages through `data`.
    fn follow(&mut self, mut data: &[u8]) -> Result<(), ServerError> {
        while !data.is_empty() {
            if self.left == 0 {
                let taken = data.len().min(PREFIX_BYTES - self.prefix_bytes);
                let end = self.prefix_bytes + taken;
                self.prefix[self.prefix_bytes..end].copy_from_slice(&data[..taken]);
                self.prefix_bytes = end;
                data = &data[taken..];
                if end < PREFIX_BYTES {
                    break;
                }
                self.prefix_bytes = 0;
                let [_, size @ ..] = self.prefix;
                self.left = u32::from_be_bytes(size) as usize;
                self.begin()?;
            }
            let taken = data.len().min(self.left);
            self.left -= taken;
            data = &data[taken..];
            if self.left == 0 && self.kind == Kind::Stream {
                self.forget();
            }
        }
        if self.kind == Kind::Single {
            return Ok(());
        }
        let is_partial = self.left > 0 || self.prefix_bytes > 0;
        match (&self.deadline, is_partial) {
            (None, true) => self.deadline = Some(Box::pin(sleep(self.arriving.deadline))),
            (Some(_), false) => self.deadline = None,
            _ => {}
        }
        Ok(())
    }

    /// Counts the message that begins, if it is not small.
    fn begin(&mut self) -> Result<(), ServerError> {
        if self.kind == Kind::Stream {
            // Each message has a time of its own.
            self.deadline = None;
        }
        if self.left <= SMALL_BYTES {
            return Ok(());
        }
        let (max, asked) = (self.arriving.max_bytes, self.left);
        let before = self.arriving.bytes.fetch_add(asked, Ordering::Relaxed);
        self.counted += asked;
        if before + asked > max {
            return Err(ServerError::TooMuchArriving { asked, arriving: before, max });
        }
        Ok(())
    }

    fn forget(&mut self) {
        let counted = std::mem::take(&mut self.counted);
        self.arriving.bytes.fetch_sub(counted, Ordering::Relaxed);
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.forget();
    }
}

impl HttpBody for Counted {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        if let Poll::Ready(Some(Ok(frame))) = &polled
            && let Some(data) = frame.data_ref()
            && let Err(error) = self.follow(data)
        {
            return Poll::Ready(Some(Err(error.into())));
        }
        if matches!(polled, Poll::Ready(None)) {
            self.deadline = None;
        }
        if polled.is_pending()
            && let Some(deadline) = &mut self.deadline
            && deadline.as_mut().poll(context).is_ready()
        {
            let deadline_s = self.arriving.deadline.as_secs();
            return Poll::Ready(Some(Err(ServerError::TooSlow { deadline_s }.into())));
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guarded(max_bytes: usize, kind: Kind) -> (Arc<Arriving>, Counted) {
        let layer = GuardLayer::new(max_bytes, Duration::from_secs(1));
        let body = Counted::new(Body::empty(), kind, Arc::clone(&layer.arriving));
        (layer.arriving, body)
    }

    fn message(size: usize) -> Vec<u8> {
        let mut bytes = vec![0];
        bytes.extend((size as u32).to_be_bytes());
        bytes.resize(PREFIX_BYTES + size, 7);
        bytes
    }

    #[tokio::test]
    async fn a_message_counts_from_its_prefix_to_its_last_byte_however_it_is_cut() {
        let bytes = [message(3), message(100_000), message(0), message(70_000)].concat();
        for piece in [1, 2, 7, 4096, bytes.len()] {
            let (arriving, mut body) = guarded(1 << 20, Kind::Stream);
            let mut largest = 0;
            for data in bytes.chunks(piece) {
                body.follow(data).unwrap();
                largest = largest.max(arriving.bytes.load(Ordering::Relaxed));
            }
            assert_eq!(
                largest,
                if piece == bytes.len() { 0 } else { 100_000 },
                "pieces of {piece}"
            );
            assert_eq!(arriving.bytes.load(Ordering::Relaxed), 0);
            assert!(body.deadline.is_none());
            body.follow(&bytes[..8 + 50_000]).unwrap();
            assert_eq!(arriving.bytes.load(Ordering::Relaxed), 100_000);
            assert!(body.deadline.is_some());
            drop(body);
            assert_eq!(arriving.bytes.load(Ordering::Relaxed), 0);
        }
    }

    #[tokio::test]
    async fn what_all_senders_announce_together_is_bounded() {
        let (arriving, mut first) = guarded(150_000, Kind::Stream);
        let mut second = Counted::new(Body::empty(), Kind::Stream, Arc::clone(&arriving));
        first.follow(&message(100_000)[..6]).unwrap();
        let error = second.follow(&message(100_000)[..6]).unwrap_err();
        assert!(error.to_string().contains("100000 bytes"), "{error}");
        drop(second);
        drop(first);
        let mut third = Counted::new(Body::empty(), Kind::Stream, Arc::clone(&arriving));
        third.follow(&message(140_000)[..6]).unwrap();
    }

    #[tokio::test]
    async fn the_message_of_a_single_call_counts_until_the_call_is_complete() {
        let (arriving, mut body) = guarded(1 << 20, Kind::Single);
        assert!(body.deadline.is_some());
        body.follow(&message(100_000)).unwrap();
        assert_eq!(arriving.bytes.load(Ordering::Relaxed), 100_000);
        assert!(body.deadline.is_some());
        drop(body);
        assert_eq!(arriving.bytes.load(Ordering::Relaxed), 0);
    }

    #[tokio::test(start_paused = true)]
    async fn a_message_that_does_not_end_in_time_ends_the_request() {
        // Half a message, and none at all.
        for (kind, bytes) in [(Kind::Stream, 9), (Kind::Single, 0)] {
            let (_arriving, mut body) = guarded(1 << 20, kind);
            body.body = Body::new(silent::Pending);
            body.follow(&message(10)[..bytes]).unwrap();
            let mut body = Box::pin(body);
            let frame = std::future::poll_fn(|context| body.as_mut().poll_frame(context)).await;
            assert_eq!(frame.unwrap().unwrap_err().code(), tonic::Code::DeadlineExceeded);
        }
    }

    /// A body that never says anything.
    mod silent {
        use super::*;

        pub(super) struct Pending;

        impl HttpBody for Pending {
            type Data = Bytes;
            type Error = Status;

            fn poll_frame(
                self: Pin<&mut Self>,
                _: &mut Context<'_>,
            ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
                Poll::Pending
            }
        }
    }
}

//! The `Results` service: questions about stored results.

use std::sync::Arc;

use sightline_proto::v1;
use tonic::{Request, Response, Status};

use super::blocking::blocking;
use super::status;
use crate::asking::{self, AskError};
use crate::state::Coordinator;

/// Serves [`v1::results_server::Results`].
pub(crate) struct ResultsService(pub(crate) Arc<Coordinator>);

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl v1::results_server::Results for ResultsService {
    async fn query(&self, r: Request<v1::QueryRequest>) -> Answer<v1::QueryResponse> {
        self.ask(r, asking::query).await
    }

    async fn why(&self, r: Request<v1::WhyRequest>) -> Answer<v1::WhyResponse> {
        let _permit = self.permit().await?;
        self.ask(r, asking::why).await
    }

    async fn measure(&self, r: Request<v1::MeasureRequest>) -> Answer<v1::MeasureResponse> {
        let _permit = self.permit().await?;
        self.ask(r, asking::measure).await
    }
}

impl ResultsService {
    /// The right to hold a scene: one question at a time does.
    async fn permit(&self) -> Result<tokio::sync::SemaphorePermit<'_>, Status> {
        let closed = |_| Status::unavailable("the coordinator is stopping; try again when it is back");
        self.0.scenes_in_memory.acquire().await.map_err(closed)
    }

    async fn ask<Q: Send + 'static, A: Send + 'static>(
        &self,
        r: Request<Q>,
        answer: fn(&Coordinator, &Q) -> Result<A, AskError>,
    ) -> Answer<A> {
        let asked = r.into_inner();
        blocking(&self.0, move |c| answer(c, &asked).map(Response::new).map_err(|e| status::of_ask(&e))).await
    }
}

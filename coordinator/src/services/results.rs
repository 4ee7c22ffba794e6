//! The `Results` service: questions about stored results.

use std::sync::Arc;

use sightline_proto::v1;
use tonic::{Request, Response, Status};

use super::blocking::{blocking, blocking_one_of};
use super::guard::own_job;
use super::status;
use crate::asking::{self, AskError};
use crate::state::Coordinator;

/// Serves [`v1::results_server::Results`].
pub(crate) struct ResultsService(pub(crate) Arc<Coordinator>);

type Answer<T> = Result<Response<T>, Status>;

#[tonic::async_trait]
impl v1::results_server::Results for ResultsService {
    async fn query(&self, r: Request<v1::QueryRequest>) -> Answer<v1::QueryResponse> {
        own_job(&self.0, &r, r.get_ref().job).await?;
        self.ask(r, asking::query).await
    }

    async fn why(&self, r: Request<v1::WhyRequest>) -> Answer<v1::WhyResponse> {
        own_job(&self.0, &r, r.get_ref().job).await?;
        self.ask_one(r, asking::why).await
    }

    async fn measure(&self, r: Request<v1::MeasureRequest>) -> Answer<v1::MeasureResponse> {
        own_job(&self.0, &r, r.get_ref().job).await?;
        self.ask_one(r, asking::measure).await
    }
}

impl ResultsService {
    /// Answers a question that needs the scene: one at a time.
    async fn ask_one<Q: Send + 'static, A: Send + 'static>(
        &self,
        r: Request<Q>,
        answer: fn(&Coordinator, &Q) -> Result<A, AskError>,
    ) -> Answer<A> {
        let asked = r.into_inner();
        let answer =
            move |c: &Arc<Coordinator>| answer(c, &asked).map(Response::new).map_err(|e| status::of_ask(&e));
        blocking_one_of(&self.0, &self.0.scenes_in_memory, answer).await
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

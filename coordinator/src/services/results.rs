//! The `Results` service: queries about stored results.

use std::sync::Arc;

use sightline_proto::v1;
use tonic::{Request, Response};

use super::authorize::{caller, own_job};
use super::blocking::in_turn;
use super::{Answer, status};
use crate::coordinator::Coordinator;
use crate::results::queries::{self, AskError};

/// Serves [`v1::results_server::Results`].
pub(crate) struct ResultsService(pub(crate) Arc<Coordinator>);

/// A query that needs the scene. It stops when its last argument returns true.
type Question<Q, A> = fn(&Coordinator, &Q, &(dyn Fn() -> bool + Sync)) -> Result<A, AskError>;

#[tonic::async_trait]
impl v1::results_server::Results for ResultsService {
    async fn query(&self, r: Request<v1::QueryRequest>) -> Answer<v1::QueryResponse> {
        own_job(&self.0, &r, r.get_ref().job).await?;
        let user = caller(&self.0, &r)?;
        let asked = r.into_inner();
        let answer = move |c: &Arc<Coordinator>, _: &(dyn Fn() -> bool + Sync)| {
            queries::query(c, &asked)
                .map(Response::new)
                .map_err(|e| status::of_ask(&e))
        };
        in_turn(&self.0, &self.0.results.lookups, user.owner(), answer).await
    }

    async fn why(&self, r: Request<v1::WhyRequest>) -> Answer<v1::WhyResponse> {
        own_job(&self.0, &r, r.get_ref().job).await?;
        self.ask(r, queries::why).await
    }

    async fn measure(&self, r: Request<v1::MeasureRequest>) -> Answer<v1::MeasureResponse> {
        own_job(&self.0, &r, r.get_ref().job).await?;
        self.ask(r, queries::measure).await
    }
}

impl ResultsService {
    /// Answers a query that needs the scene. One query runs at a time.
    async fn ask<Q: Send + 'static, A: Send + 'static>(
        &self,
        r: Request<Q>,
        answer: Question<Q, A>,
    ) -> Answer<A> {
        let user = caller(&self.0, &r)?;
        let asked = r.into_inner();
        let answer = move |c: &Arc<Coordinator>, is_gone: &(dyn Fn() -> bool + Sync)| {
            answer(c, &asked, is_gone)
                .map(Response::new)
                .map_err(|e| status::of_ask(&e))
        };
        in_turn(&self.0, &self.0.results.questions, user.owner(), answer).await
    }
}

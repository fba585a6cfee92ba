//! The OpenAPI document, made from the table of routes.
//!
//! Purpose: [`document`] writes each [`Route`] as an operation; [`Parameter`], [`Content`] and [`Answer`] are what a row of the
//! table consists of. Invariant: bodies have the schemas of the types that handlers serialize, options and specifications of jobs
//! those of the protobuf schema, and formats come from the library. Must not know: single routes, how a handler works.

use schemars::SchemaGenerator;
use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::problem::ProblemBody;
use super::schema::{BYTES, JSON, PROBLEM, Shape, whole};
use super::{Route, options};
use geometry::mesh::io::Format;
use wire::proto::{GetServerInfoResponse, JobSpec};

/// A parameter of a request, or a header of an answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameter {
    name: &'static str,
    /// `path`, `query` or `header`.
    place: &'static str,
    description: &'static str,
    shape: Shape,
}

impl Parameter {
    pub(super) const fn path(name: &'static str, description: &'static str, shape: Shape) -> Self {
        Self { name, place: "path", description, shape }
    }

    pub(super) const fn query(name: &'static str, description: &'static str, shape: Shape) -> Self {
        Self { name, place: "query", description, shape }
    }

    pub(super) const fn header(name: &'static str, description: &'static str, shape: Shape) -> Self {
        Self { name, place: "header", description, shape }
    }

    fn of_request(&self, schemas: &mut SchemaGenerator) -> Value {
        let Self { name, place, description, shape } = self;
        let mut parameter = json!({ "name": name, "in": place, "description": description, "schema": shape(schemas) });
        if *place == "path" {
            parameter["required"] = true.into();
        }
        parameter
    }
}

/// A body.
#[derive(Clone, Copy, Debug)]
pub(super) enum Content {
    Nothing,
    /// A mesh in one of the library's formats.
    Mesh,
    /// Of this media type.
    Plain(&'static str),
    /// Of this media type and this schema.
    Typed(&'static str, Shape),
}

impl Content {
    pub(super) const fn json(shape: Shape) -> Self {
        Self::Typed(JSON, shape)
    }

    fn by_media_type(self, schemas: &mut SchemaGenerator) -> Map<String, Value> {
        let plain = |media_type: &str| (media_type.to_owned(), json!({}));
        match self {
            Self::Nothing => Map::new(),
            Self::Mesh => Format::ALL.map(options::media_type).into_iter().chain([BYTES]).map(plain).collect(),
            Self::Plain(media_type) => [plain(media_type)].into_iter().collect(),
            Self::Typed(media_type, shape) => {
                [(media_type.to_owned(), json!({ "schema": shape(schemas) }))].into_iter().collect()
            }
        }
    }
}

/// An answer. Those that are problems are added to every route.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    status: u16,
    description: &'static str,
    content: Content,
    headers: &'static [Parameter],
}

impl Answer {
    pub(super) const fn new(status: u16, description: &'static str, content: Content) -> Self {
        Self { status, description, content, headers: &[] }
    }

    pub(super) const fn with(self, headers: &'static [Parameter]) -> Self {
        Self { headers, ..self }
    }

    fn described(&self, schemas: &mut SchemaGenerator) -> Value {
        let mut answer = json!({ "description": self.description });
        let content = self.content.by_media_type(schemas);
        if !content.is_empty() {
            answer["content"] = content.into();
        }
        for Parameter { name, description, shape, .. } in self.headers {
            answer["headers"][*name] = json!({ "description": description, "schema": shape(schemas) });
        }
        answer
    }
}

/// The answer to any request that fails; its status depends on the problem.
const FAILED: Answer = Answer::new(
    0,
    "A problem. Programs read `reason`.",
    Content::Typed(PROBLEM, |schemas| schemas.subschema_for::<ProblemBody>()),
)
.with(&[Parameter::header("Retry-After", "Seconds until another try is worth it.", whole)]);

fn operation(route: &Route, schemas: &mut SchemaGenerator) -> Value {
    let mut parameters: Vec<Value> = route.parameters.iter().map(|one| one.of_request(schemas)).collect();
    if route.takes_options {
        let of = |(name, schema): (String, Value)| json!({ "name": name, "in": "query", "description": schema["description"], "schema": schema });
        parameters.extend(options::all().into_iter().map(of));
    }
    let mut responses = json!({});
    for answer in route.answers {
        responses[answer.status.to_string()] = answer.described(schemas);
    }
    responses["default"] = json!({ "$ref": "#/components/responses/Problem" });
    let mut operation = json!({
        "operationId": route.id,
        "summary": route.summary,
        "description": route.description,
        // A server without `--require-keys` needs none. With keys, the key needs this role.
        "security": [{}, { "key": [route.role.name()] }],
        "parameters": parameters,
        "responses": responses,
    });
    let mut body = route.body.by_media_type(schemas);
    if matches!(route.body, Content::Mesh | Content::Plain(_)) {
        let file = json!({ "type": "object", "properties": { "file": { "type": "string", "format": "binary" } } });
        body.insert("multipart/form-data".to_owned(), json!({ "schema": file }));
    }
    if !body.is_empty() {
        operation["requestBody"] = json!({ "required": true, "content": body });
    }
    operation
}

/// The document of these routes.
pub(super) fn document(routes: &[Route]) -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    let mut schemas = settings.with(|all| all.definitions_path = "/components/schemas".into()).into_generator();
    let mut paths = json!({});
    for route in routes {
        paths[route.path][route.method.to_ascii_lowercase()] = operation(route, &mut schemas);
    }
    let problem = FAILED.described(&mut schemas);
    let mut components = schemas.take_definitions(true);
    components.insert("Digest".to_owned(), json!({ "type": "string", "pattern": "^[0-9a-f]{64}$" }));
    components.insert("Options".to_owned(), options::schema());
    components.extend(wire::json::schemas::<JobSpec>("#/components/schemas/"));
    components.extend(wire::json::schemas::<GetServerInfoResponse>("#/components/schemas/"));
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Tessera",
            "version": "1",
            "summary": "Remeshing: a mesh in, a mesh out.",
            "description": "The HTTP interface of `tessera serve --http-listen`. Its jobs, blobs, keys and limits are those of the \
                            gRPC service.",
            "license": { "name": "MIT", "identifier": "MIT" },
        },
        "servers": [{ "url": "/" }],
        "paths": paths,
        "components": {
            "securitySchemes": {
                "key": {
                    "type": "http",
                    "scheme": "bearer",
                    "description": "A key of `tessera keys add`: `Authorization: Bearer tsr_...`",
                },
            },
            "responses": { "Problem": problem },
            "schemas": components,
        },
    })
}

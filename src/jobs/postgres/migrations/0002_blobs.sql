-- The index of blobs: which are stored, whose they are, what pins them, uploads under way.
--
-- A process that takes a blob out locks its row for update first, and looks at its pins in a later statement. One that pins a blob
-- locks its row for key share first. So a pin is never of a blob that is not there.

-- Blobs whose bytes are stored.
create table tessera.blobs (
    digest bytea primary key check (octet_length(digest) = 32),
    size bigint not null,
    -- The time of the last use, nanoseconds since 1970; unique.
    used bigint not null
);
create index blobs_used on tessera.blobs (used);

create table tessera.owners (
    digest bytea not null references tessera.blobs (digest) on delete cascade,
    owner bytea not null,
    -- Rises: the oldest goes first.
    since bigint generated always as identity,
    primary key (digest, owner)
);
create index owners_owner on tessera.owners (owner, since);

create table tessera.pins (
    name text collate "C" not null,
    digest bytea not null references tessera.blobs (digest),
    -- In whose name; of all digests of a name the same.
    owner bytea,
    primary key (name, digest)
);
create index pins_digest on tessera.pins (digest);

create table tessera.uploads (
    digest bytea not null,
    size bigint not null,
    -- Sixteen zeros for the server's own.
    owner bytea not null,
    -- When it was continued last, milliseconds since 1970.
    touched bigint not null,
    primary key (digest, size, owner)
);

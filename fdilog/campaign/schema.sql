-- One row a log of a campaign; a result belongs to a content, a configuration and a version, so
-- that two paths with one content share it. Times are seconds of flight, rates rad/s.

CREATE TABLE runs (
    run INTEGER PRIMARY KEY,
    started_utc TEXT NOT NULL,
    finished_utc TEXT,              -- NULL: interrupted
    fdilog_version TEXT NOT NULL,
    config_sha256 TEXT NOT NULL,
    targets TEXT NOT NULL,          -- JSON list
    logs INTEGER NOT NULL,          -- found
    analysed INTEGER NOT NULL,      -- handed to a worker in this run
    reused INTEGER NOT NULL         -- known from before, by path or by content
);

CREATE TABLE logs (
    path_raw BLOB PRIMARY KEY,      -- the bytes of the path
    path TEXT NOT NULL,             -- the same as text; a byte that is no UTF-8 as \xff
    listed INTEGER NOT NULL,        -- 1: found by the latest run
    bytes INTEGER NOT NULL,
    stamp TEXT NOT NULL,            -- time of modification, or a tag, when it was analysed
    sha256 TEXT,
    result TEXT REFERENCES results (result),
    error_kind TEXT,                -- why there is no result: died, timeout, memory, unreachable, ... see the guide
    error TEXT,
    vehicle TEXT,
    vehicle_from TEXT               -- board serial, unique id, system id, folder
);

CREATE TABLE results (
    result TEXT PRIMARY KEY,        -- hash of the next three
    log_sha256 TEXT NOT NULL,
    config_sha256 TEXT NOT NULL,
    fdilog_version TEXT NOT NULL,
    verdict TEXT,                   -- failed, healthy, undecided, insufficient; NULL: see error
    error_kind TEXT,                -- unreadable, no-gyro, configuration
    error TEXT,
    format TEXT,
    bytes INTEGER,
    start_utc TEXT,
    duration_s REAL,
    samples INTEGER,
    rate_hz REAL,
    whole INTEGER,
    bytes_lost INTEGER,
    seconds_lost REAL,
    reports TEXT                    -- JSON list of files in the folder of the audit
);

CREATE TABLE facts (                -- what the log says of the vehicle
    result TEXT NOT NULL REFERENCES results (result) ON DELETE CASCADE,
    name TEXT NOT NULL,
    value TEXT NOT NULL,
    PRIMARY KEY (result, name)
) WITHOUT ROWID;

CREATE TABLE sources (
    result TEXT NOT NULL REFERENCES results (result) ON DELETE CASCADE,
    position INTEGER NOT NULL,
    name TEXT NOT NULL,
    topic TEXT,
    used INTEGER,
    reason TEXT,
    rate_hz REAL,
    samples INTEGER,
    derived INTEGER,
    device_id TEXT,                 -- INS_GYR_ID and its like, where the log has it
    PRIMARY KEY (result, position)
) WITHOUT ROWID;

CREATE TABLE channels (
    result TEXT NOT NULL REFERENCES results (result) ON DELETE CASCADE,
    position INTEGER NOT NULL,
    name TEXT NOT NULL,
    source TEXT NOT NULL,
    status TEXT NOT NULL,
    rate_hz REAL,
    samples INTEGER,
    sigma_rad_s REAL,
    derived INTEGER,
    PRIMARY KEY (result, position)
) WITHOUT ROWID;

CREATE TABLE measures (             -- a flight's mean error and noise of a channel, 95 % intervals
    result TEXT NOT NULL REFERENCES results (result) ON DELETE CASCADE,
    channel TEXT NOT NULL,
    quantity TEXT NOT NULL,         -- bias, noise
    estimate_rad_s REAL NOT NULL,
    low_rad_s REAL NOT NULL,
    high_rad_s REAL NOT NULL,
    PRIMARY KEY (result, channel, quantity)
) WITHOUT ROWID;

CREATE TABLE findings (
    result TEXT NOT NULL REFERENCES results (result) ON DELETE CASCADE,
    position INTEGER NOT NULL,
    kind TEXT NOT NULL,
    suspects TEXT NOT NULL,         -- JSON list
    isolated INTEGER NOT NULL,
    start_s REAL,
    end_s REAL,
    size REAL,
    size_low REAL,
    size_high REAL,
    confidence REAL,
    unit TEXT,
    guaranteed_low_rad_s REAL,
    guaranteed_high_rad_s REAL,
    detectors TEXT,                 -- JSON list
    dissent TEXT,                   -- JSON list
    witness TEXT,
    detail TEXT,
    PRIMARY KEY (result, position)
) WITHOUT ROWID;

CREATE TABLE problems (
    result TEXT NOT NULL REFERENCES results (result) ON DELETE CASCADE,
    position INTEGER NOT NULL,
    offset INTEGER,
    what TEXT NOT NULL,
    bytes INTEGER,
    seconds REAL,
    note INTEGER,
    PRIMARY KEY (result, position)
) WITHOUT ROWID;

CREATE INDEX logs_by_result ON logs (result);
CREATE INDEX logs_by_sha256 ON logs (sha256);

-- The campaign as of the latest run, a row a log.
CREATE VIEW flights AS
SELECT l.path, l.bytes, l.vehicle, l.vehicle_from, r.verdict,
       coalesce(l.error_kind, r.error_kind) AS error_kind, coalesce(l.error, r.error) AS error,
       r.format, r.start_utc, r.duration_s, r.samples, r.rate_hz, r.whole, r.bytes_lost,
       r.seconds_lost,
       (SELECT count(*) FROM findings f WHERE f.result = l.result) AS findings,
       (SELECT count(*) FROM problems p WHERE p.result = l.result AND NOT p.note) AS losses,
       r.reports, l.sha256, l.result
FROM logs l LEFT JOIN results r ON r.result = l.result
WHERE l.listed;

-- A row for each channel that a finding names.
CREATE VIEW accusations AS
SELECT l.path, l.vehicle, r.start_utc, s.value AS channel, f.isolated, f.kind, f.start_s, f.end_s,
       f.size, f.size_low, f.size_high, f.unit, f.detail
FROM logs l JOIN results r ON r.result = l.result JOIN findings f ON f.result = l.result,
     json_each(f.suspects) s
WHERE l.listed;

-- The same content under two names is one flight of a vehicle.
CREATE VIEW vehicle_results AS
SELECT DISTINCT vehicle, result FROM logs WHERE listed AND result IS NOT NULL;

-- How often each channel of each vehicle was compared, and how often it failed.
CREATE VIEW vehicle_channels AS
SELECT v.vehicle, c.name AS channel, count(*) AS flights, sum(c.status = 'failed') AS failed,
       sum(c.status = 'suspect') AS suspect, sum(c.status = 'undecided') AS undecided,
       sum(c.status = 'healthy') AS healthy, sum(c.status = 'insufficient') AS insufficient
FROM vehicle_results v JOIN channels c ON c.result = v.result
WHERE NOT c.derived
GROUP BY v.vehicle, c.name;

-- Bias and noise of each channel, flight by flight.
CREATE VIEW sensor_history AS
SELECT v.vehicle, c.source AS sensor,
       (SELECT max(s.device_id) FROM sources s  -- a sensor that is logged twice has a row for each
        WHERE s.result = v.result AND s.name = c.source) AS device_id,
       m.channel, m.quantity, r.start_utc,
       (SELECT min(path) FROM logs WHERE result = v.result AND listed) AS path,
       m.estimate_rad_s, m.low_rad_s, m.high_rad_s
FROM vehicle_results v JOIN results r ON r.result = v.result JOIN measures m ON m.result = v.result
     JOIN channels c ON c.result = v.result AND c.name = m.channel;

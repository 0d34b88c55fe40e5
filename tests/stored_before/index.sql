BEGIN TRANSACTION;
CREATE TABLE alarms (
	"key" VARCHAR NOT NULL, 
	kind VARCHAR NOT NULL, 
	priority VARCHAR NOT NULL, 
	active BOOLEAN NOT NULL, 
	text VARCHAR NOT NULL, 
	began_ms DOUBLE NOT NULL, 
	ended_ms DOUBLE, 
	acknowledged_by VARCHAR, 
	change INTEGER NOT NULL, 
	message JSON NOT NULL, 
	PRIMARY KEY ("key")
);
INSERT INTO "alarms" VALUES('1796007796046.663/force-1','force','low',0,'Force near the injury threshold (bladder)',1.79600779604666333007e+12,1.79600779694666870122e+12,NULL,4,'{"type": "alarm", "id": "force-1", "kind": "force", "priority": "low", "active": false, "latched": false, "text": "Force near the injury threshold (bladder)", "value": 1.6713570566113563, "limit": 2.252, "unit": "N", "began_ms": 1796007796046.6633, "ended_ms": 1796007796946.6687, "acknowledged_by": null, "change": 4}');
INSERT INTO "alarms" VALUES('1796007796489.976/late-2','technical','medium',1,'Samples are read more than 0.1 s late, and the limiter acts as late: end other programs',1.79600779648997607423e+12,NULL,'Ada',2,'{"type": "alarm", "id": "late-2", "kind": "technical", "priority": "medium", "active": true, "latched": false, "text": "Samples are read more than 0.1 s late, and the limiter acts as late: end other programs", "value": null, "limit": null, "unit": null, "began_ms": 1796007796489.976, "ended_ms": null, "acknowledged_by": "Ada", "change": 2}');
CREATE TABLE audit (
	"key" VARCHAR(64) NOT NULL, 
	at_ms DOUBLE NOT NULL, 
	kind VARCHAR NOT NULL, 
	text VARCHAR NOT NULL, 
	"by" VARCHAR, 
	message JSON NOT NULL, 
	PRIMARY KEY ("key")
);
INSERT INTO "audit" VALUES('dfc5e433d78bc1f3b06a37bb87b1e22257fe43b83ead47eb8cc0f47a03432fbc',1.79600779510730786136e+12,'chain','The chain of the journal begins',NULL,'{"at": "2026-11-30T03:03:15.107308+00:00", "kind": "chain", "text": "The chain of the journal begins", "by": null, "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 1, "after": null, "begins": "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855", "torn": null, "hash": "e9d7014f25b7ea78371da92289d883353cf04351e5256779c6573e39fa12bc6b"}');
INSERT INTO "audit" VALUES('8b2393a4fde4f12fbe943a81caa6d9fc8261e4c17c591cc44101ed43f63dbf26',1.79600779510730786136e+12,'event','The tool is acquiring; priority granted, memory lock not asked for, any core, garbage frozen',NULL,'{"at": "2026-11-30T03:03:15.107308+00:00", "kind": "event", "text": "The tool is acquiring; priority granted, memory lock not asked for, any core, garbage frozen", "by": null, "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 2, "after": "e9d7014f25b7ea78371da92289d883353cf04351e5256779c6573e39fa12bc6b", "begins": null, "torn": null, "hash": "e7d5fdc45d8a235f5d7d0b568001ee4531ba39a63f588ca4c976d2969c220180"}');
INSERT INTO "audit" VALUES('c6bb3eb5c6c6061ef7f2c5b365245aca9e098e684aa44363257f47372098be00',1.79600779543443383784e+12,'event','Armed: tare and self-test passed','Ada','{"at": "2026-11-30T03:03:15.434434+00:00", "kind": "event", "text": "Armed: tare and self-test passed", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 3, "after": "e7d5fdc45d8a235f5d7d0b568001ee4531ba39a63f588ca4c976d2969c220180", "begins": null, "torn": null, "hash": "e4c4b3ad844be7ebcc3979a2a8fc9d0b49c3443899db7b9ef1561906439115ab"}');
INSERT INTO "audit" VALUES('642c9f571be43d692ca6199ed68a09ce104e7c9db813feaaf92f2de3fe31f71d',1.79600779544604199217e+12,'run','Run started: Strong trapezoid, 2 Hz ramps, 3.5 V, 1 grasps, bladder','Ada','{"at": "2026-11-30T03:03:15.446042+00:00", "kind": "run", "text": "Run started: Strong trapezoid, 2 Hz ramps, 3.5 V, 1 grasps, bladder", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": {"id": "20261130-030315-68cf-001", "protocol": "strong_2hz", "cycles": 1, "tissue": "bladder", "by": "Ada", "state": "running", "started_at": "2026-11-30T03:03:15.437175+00:00", "ended_at": null, "why": null, "grasps": 0}, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 4, "after": "e4c4b3ad844be7ebcc3979a2a8fc9d0b49c3443899db7b9ef1561906439115ab", "begins": null, "torn": null, "hash": "788d180495ce28d54ca216d14619acf8a9e960022e653572baeef6e8b0f088ad"}');
INSERT INTO "audit" VALUES('14890ae3f4e2358cf2b9a8536201afee7a839a7faa064d1bd9d39710f01554d3',1.79600779544934204099e+12,'request','Start run strong_2hz on bladder: done','Ada','{"at": "2026-11-30T03:03:15.449342+00:00", "kind": "request", "text": "Start run strong_2hz on bladder: done", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": "start_run", "client": "127.0.0.1", "result": "done", "reason": null, "chain": "5b2eea5e", "number": 5, "after": "788d180495ce28d54ca216d14619acf8a9e960022e653572baeef6e8b0f088ad", "begins": null, "torn": null, "hash": "53ecb56f880572c16ec15332b46137c7b4f795eab3b557965835fcede6bba0e2"}');
INSERT INTO "audit" VALUES('b8204870dab78a415b51afc8a1f4e8abb385892e7092c8608db2e0a80e6dbb9e',1.79600779604967602533e+12,'alarm','Low alarm: Force near the injury threshold (bladder)',NULL,'{"at": "2026-11-30T03:03:16.049676+00:00", "kind": "alarm", "text": "Low alarm: Force near the injury threshold (bladder)", "by": null, "priority": "low", "value": 1.5841012397923773, "limit": 2.252, "unit": "N", "run": null, "alarm": {"type": "alarm", "id": "force-1", "kind": "force", "priority": "low", "active": true, "latched": false, "text": "Force near the injury threshold (bladder)", "value": 1.5841012397923773, "limit": 2.252, "unit": "N", "began_ms": 1796007796046.6633, "ended_ms": null, "acknowledged_by": null, "change": 1}, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 6, "after": "53ecb56f880572c16ec15332b46137c7b4f795eab3b557965835fcede6bba0e2", "begins": null, "torn": null, "hash": "8d06a2d1723fa55ac72f69332a771284992d67f0a1cd92587149251dda34f250"}');
INSERT INTO "audit" VALUES('c0a39d11e63756a5de8d7fdf3bd80f1c06fe02b456ade6ac22a7bcd79c7ecee5',1.79600779650773803713e+12,'alarm','Medium alarm: Samples are read more than 0.1 s late, and the limiter acts as late: end other programs',NULL,'{"at": "2026-11-30T03:03:16.507738+00:00", "kind": "alarm", "text": "Medium alarm: Samples are read more than 0.1 s late, and the limiter acts as late: end other programs", "by": null, "priority": "medium", "value": null, "limit": null, "unit": null, "run": null, "alarm": {"type": "alarm", "id": "late-2", "kind": "technical", "priority": "medium", "active": true, "latched": false, "text": "Samples are read more than 0.1 s late, and the limiter acts as late: end other programs", "value": null, "limit": null, "unit": null, "began_ms": 1796007796489.976, "ended_ms": null, "acknowledged_by": null, "change": 1}, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 7, "after": "8d06a2d1723fa55ac72f69332a771284992d67f0a1cd92587149251dda34f250", "begins": null, "torn": null, "hash": "310f2dce2df46733cbaf1cf80ba925ae3724b0a643968017fbf92dd4952bca8d"}');
INSERT INTO "audit" VALUES('a47a0a9c6cce553f1e780b74f884252f3b135ffc1521539455529b0d1e05fdc0',1.79600779694959912114e+12,'alarm','Over: Force near the injury threshold (bladder)',NULL,'{"at": "2026-11-30T03:03:16.949599+00:00", "kind": "alarm", "text": "Over: Force near the injury threshold (bladder)", "by": null, "priority": "low", "value": 1.6713570566113563, "limit": 2.252, "unit": "N", "run": null, "alarm": {"type": "alarm", "id": "force-1", "kind": "force", "priority": "low", "active": false, "latched": false, "text": "Force near the injury threshold (bladder)", "value": 1.6713570566113563, "limit": 2.252, "unit": "N", "began_ms": 1796007796046.6633, "ended_ms": 1796007796946.6687, "acknowledged_by": null, "change": 4}, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 8, "after": "310f2dce2df46733cbaf1cf80ba925ae3724b0a643968017fbf92dd4952bca8d", "begins": null, "torn": null, "hash": "5a9f807f54f8226a156981fb5962d52349a73ec91652a9c0a0409ffce7ad21cf"}');
INSERT INTO "audit" VALUES('ec60932dad96e4468532a8f16a25c1d0f67aca34f34cef83f20cc38e9c85dcdc',1.7960077975086259765e+12,'run','Run finished: all cycles are done',NULL,'{"at": "2026-11-30T03:03:17.508626+00:00", "kind": "run", "text": "Run finished: all cycles are done", "by": null, "priority": null, "value": null, "limit": null, "unit": null, "run": {"id": "20261130-030315-68cf-001", "protocol": "strong_2hz", "cycles": 1, "tissue": "bladder", "by": "Ada", "state": "finished", "started_at": "2026-11-30T03:03:15.437175+00:00", "ended_at": "2026-11-30T03:03:17.508457+00:00", "why": "all cycles are done", "grasps": 1}, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 9, "after": "5a9f807f54f8226a156981fb5962d52349a73ec91652a9c0a0409ffce7ad21cf", "begins": null, "torn": null, "hash": "09588d72f70e86733eafd20ce150831a6d4fce9553ce0a3c67186d851a117dda"}');
INSERT INTO "audit" VALUES('d925ec1a3a48ecdd3000fbe026ccbd91e05f5e8526739d889451a1a200148b96',1.79600779906821606448e+12,'acknowledged','Acknowledged: Samples are read more than 0.1 s late, and the limiter acts as late: end other programs','Ada','{"at": "2026-11-30T03:03:19.068216+00:00", "kind": "acknowledged", "text": "Acknowledged: Samples are read more than 0.1 s late, and the limiter acts as late: end other programs", "by": "Ada", "priority": "medium", "value": null, "limit": null, "unit": null, "run": null, "alarm": {"type": "alarm", "id": "late-2", "kind": "technical", "priority": "medium", "active": true, "latched": false, "text": "Samples are read more than 0.1 s late, and the limiter acts as late: end other programs", "value": null, "limit": null, "unit": null, "began_ms": 1796007796489.976, "ended_ms": null, "acknowledged_by": "Ada", "change": 2}, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 10, "after": "09588d72f70e86733eafd20ce150831a6d4fce9553ce0a3c67186d851a117dda", "begins": null, "torn": null, "hash": "a25f6011a121c5b033ba7b4f386b7408f059fafdf544953a94edbae5156377d8"}');
INSERT INTO "audit" VALUES('bfa37a32ca891706f03333a46936bf4f42657bb364f86a62f5c0646b1f497be9',1.79600779907224389645e+12,'request','Acknowledge late-2: done','Ada','{"at": "2026-11-30T03:03:19.072244+00:00", "kind": "request", "text": "Acknowledge late-2: done", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": "acknowledge", "client": "127.0.0.1", "result": "done", "reason": null, "chain": "5b2eea5e", "number": 11, "after": "a25f6011a121c5b033ba7b4f386b7408f059fafdf544953a94edbae5156377d8", "begins": null, "torn": null, "hash": "2ad1e49520066c08c39262fd101605bbec9ec0463770809e60cb51aab092497d"}');
INSERT INTO "audit" VALUES('1c6af7610fc638eb91c7216a008a7606c14dc3a9ae5c273a419b03f840074b34',1796007799144.42,'deleted','Recording 20261130-030315-68cf-001.mcap is being deleted','Ada','{"at": "2026-11-30T03:03:19.144420+00:00", "kind": "deleted", "text": "Recording 20261130-030315-68cf-001.mcap is being deleted", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": {"name": "20261130-030315-68cf-001.mcap", "run_id": "20261130-030315-68cf-001", "size_bytes": 650111, "made_at": "2026-11-30T03:03:18+00:00", "duration_s": 3.9, "samples": 3900, "lost_samples": 0, "format_version": "1", "condition": "complete", "problem": null, "deleted_at": "2026-11-30T03:03:19.118259+00:00", "deleted_by": "Ada"}, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 12, "after": "2ad1e49520066c08c39262fd101605bbec9ec0463770809e60cb51aab092497d", "begins": null, "torn": null, "hash": "45ba6e50f64ac34d1f1dc72021eb24d6bee96ed77c27182d518fbc321aba75e5"}');
INSERT INTO "audit" VALUES('4ef1d940d5ad1932516de978cbaf8d4336ef9d821b653187a46f9dc576d4b422',1.79600779917521606449e+12,'event','Recording 20261130-030315-68cf-001.mcap deleted: it is in the bin','Ada','{"at": "2026-11-30T03:03:19.175216+00:00", "kind": "event", "text": "Recording 20261130-030315-68cf-001.mcap deleted: it is in the bin", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 13, "after": "45ba6e50f64ac34d1f1dc72021eb24d6bee96ed77c27182d518fbc321aba75e5", "begins": null, "torn": null, "hash": "1438163ecffba38f022e99322219fc45ba367f9a07ba2096608dc121e220bf60"}');
INSERT INTO "audit" VALUES('1d8257c589bd091746332bcdd6a6756770f1962fb455893e8b3610a0c3bdfe3f',1.79600779917755615233e+12,'request','Delete 20261130-030315-68cf-001.mcap: done','Ada','{"at": "2026-11-30T03:03:19.177556+00:00", "kind": "request", "text": "Delete 20261130-030315-68cf-001.mcap: done", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": "delete", "client": "127.0.0.1", "result": "done", "reason": null, "chain": "5b2eea5e", "number": 14, "after": "1438163ecffba38f022e99322219fc45ba367f9a07ba2096608dc121e220bf60", "begins": null, "torn": null, "hash": "8b34f1ae13ec6416e28fd57f85b989e021414e9d51514169be3e76c1c62aa530"}');
INSERT INTO "audit" VALUES('c3260d4146c8a9f1cf55af225288fa0847ee515dd926fa164210de2f0f04b129',1.79600779929534204101e+12,'restored','Recording 20261130-030315-68cf-001.mcap restored','Ada','{"at": "2026-11-30T03:03:19.295342+00:00", "kind": "restored", "text": "Recording 20261130-030315-68cf-001.mcap restored", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": {"name": "20261130-030315-68cf-001.mcap", "run_id": "20261130-030315-68cf-001", "size_bytes": 650111, "made_at": "2026-11-30T03:03:18+00:00", "duration_s": 3.9, "samples": 3900, "lost_samples": 0, "format_version": "1", "condition": "complete", "problem": null, "deleted_at": null, "deleted_by": null}, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 15, "after": "8b34f1ae13ec6416e28fd57f85b989e021414e9d51514169be3e76c1c62aa530", "begins": null, "torn": null, "hash": "57106cd2a60bd50bae17ecd851e7135f972ab2450ccd33fac3df9f6de3652059"}');
INSERT INTO "audit" VALUES('1e482f4b7749b2ead6fe2cf4437a02670df4af874420f6478cfcc87c0952227f',1.79600779929596899415e+12,'event','Recording 20261130-030315-68cf-001.mcap restored','Ada','{"at": "2026-11-30T03:03:19.295969+00:00", "kind": "event", "text": "Recording 20261130-030315-68cf-001.mcap restored", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": null, "client": null, "result": null, "reason": null, "chain": "5b2eea5e", "number": 16, "after": "57106cd2a60bd50bae17ecd851e7135f972ab2450ccd33fac3df9f6de3652059", "begins": null, "torn": null, "hash": "a57a31f16e0dfdce52dcb43114e14dab089f6cce0a265be3587123907f4036b8"}');
INSERT INTO "audit" VALUES('72c152efc45055e0c4adafc69bdd5e38b2c176282ea80413223b7369581339ce',1.79600779932430419921e+12,'request','Restore 20261130T030319118259Z: done','Ada','{"at": "2026-11-30T03:03:19.324304+00:00", "kind": "request", "text": "Restore 20261130T030319118259Z: done", "by": "Ada", "priority": null, "value": null, "limit": null, "unit": null, "run": null, "alarm": null, "file": null, "action": "restore", "client": "127.0.0.1", "result": "done", "reason": null, "chain": "5b2eea5e", "number": 17, "after": "a57a31f16e0dfdce52dcb43114e14dab089f6cce0a265be3587123907f4036b8", "begins": null, "torn": null, "hash": "5be2ffe356fb1c79b62ce1238276d3420aa0913e02940a9b4e4f706c029b933c"}');
CREATE TABLE files (
	name VARCHAR NOT NULL, 
	run_id VARCHAR, 
	size_bytes BIGINT NOT NULL, 
	made_ms DOUBLE NOT NULL, 
	duration_s DOUBLE, 
	samples BIGINT, 
	lost_samples BIGINT, 
	condition VARCHAR, 
	message JSON NOT NULL, deleted_ms DOUBLE, deleted_by VARCHAR, 
	PRIMARY KEY (name)
);
INSERT INTO "files" VALUES('20261130-030315-68cf-001.mcap','20261130-030315-68cf-001',650111,1796007798000.0,3.9,3900,0,'complete','{"name": "20261130-030315-68cf-001.mcap", "run_id": "20261130-030315-68cf-001", "size_bytes": 650111, "made_at": "2026-11-30T03:03:18+00:00", "duration_s": 3.9, "samples": 3900, "lost_samples": 0, "format_version": "1", "condition": "complete", "problem": null, "deleted_at": null, "deleted_by": null}',NULL,NULL);
CREATE TABLE "grasps" (
	run_id VARCHAR NOT NULL, 
	"index" INTEGER NOT NULL, 
	label VARCHAR NOT NULL, 
	probability DOUBLE, 
	peak_force_n DOUBLE, 
	valid BOOLEAN NOT NULL, 
	message JSON NOT NULL, 
	held_back BOOLEAN NOT NULL, 
	PRIMARY KEY (run_id, "index"), 
	FOREIGN KEY(run_id) REFERENCES runs (id)
);
INSERT INTO "grasps" VALUES('20261130-030315-68cf-001',1,'bladder',0.999897516105924,1.68694972268006249116e+00,1,'{"type": "grasp", "run_id": "20261130-030315-68cf-001", "grasp": {"index": 1, "start_s": 1.346, "contact_s": 1.374, "end_s": 2.39, "label": "bladder", "probability": 0.999897516105924, "probabilities": {"liver": 8.68313354620619e-108, "small_bowel": 1.8966254506800028e-98, "bladder": 0.999897516105924, "gallbladder": 1.100873195842558e-55, "unknown": 0.00010248389407587163}, "time_to_decision_s": 0.05, "alpha_n": 0.003967744527266828, "beta_per_m": 779.4323654619303, "damping_kg_per_s": 2.3769526858934253, "peak_force_n": 1.6869497226800625, "peak_displacement_m": 0.007746156078579199, "convergence_s": {"liver": null, "small_bowel": null, "bladder": 0.029, "gallbladder": null}, "force_error_n": {"liver": 1.3251459665116996, "small_bowel": 95812.44847716713, "bladder": -0.014700941631088656, "gallbladder": -0.11375325077274452}, "valid": true, "why_invalid": null, "alarms": ["low"], "held_back": true, "peak_share_of_limit": 0.9363619686279211}}',1);
CREATE TABLE graspwatch_revision (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT graspwatch_revision_pkc PRIMARY KEY (version_num)
);
INSERT INTO "graspwatch_revision" VALUES('0002');
CREATE TABLE runs (
	id VARCHAR NOT NULL, 
	protocol VARCHAR, 
	tissue VARCHAR, 
	"by" VARCHAR, 
	state VARCHAR, 
	started_ms DOUBLE, 
	ended_ms DOUBLE, 
	why VARCHAR, 
	grasps INTEGER NOT NULL, 
	message JSON, 
	PRIMARY KEY (id)
);
INSERT INTO "runs" VALUES('20261130-030315-68cf-001','strong_2hz','bladder','Ada','finished',1.79600779543717504888e+12,1.79600779750845703126e+12,'all cycles are done',1,'{"id": "20261130-030315-68cf-001", "protocol": "strong_2hz", "cycles": 1, "tissue": "bladder", "by": "Ada", "state": "finished", "started_at": "2026-11-30T03:03:15.437175+00:00", "ended_at": "2026-11-30T03:03:17.508457+00:00", "why": "all cycles are done", "grasps": 0}');
CREATE INDEX runs_by_start ON runs (started_ms, id);
CREATE INDEX ix_runs_protocol ON runs (protocol);
CREATE INDEX ix_runs_tissue ON runs (tissue);
CREATE INDEX ix_runs_state ON runs (state);
CREATE INDEX ix_alarms_kind ON alarms (kind);
CREATE INDEX ix_alarms_began_ms ON alarms (began_ms);
CREATE INDEX audit_by_time ON audit (at_ms, "key");
CREATE INDEX ix_audit_kind ON audit (kind);
CREATE INDEX ix_audit_by ON audit ("by");
CREATE INDEX ix_files_run_id ON files (run_id);
CREATE INDEX ix_files_made_ms ON files (made_ms);
CREATE INDEX grasps_by_label ON grasps (label, valid);
COMMIT;

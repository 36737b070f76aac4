"""The live page in the browser, and the processes that it starts.

* `access`: checks token, Host and Origin of a request, and limits what a browser may load;
* `follow`, `history`, `trigger`, `view`: convert the rows of a control loop to the points that one scope draws;
* `lease`: decides which page operates the rig, and detects that the page is gone;
* `live`, `runs`: the loop that the pages show; the runs and changes that a page starts;
* `jobs`, `worker`: *jobs* (runs, sessions, maps) in a process of their own, through the functions of the commands;
* `errands`, `errand_worker`: *errands* (reading, drawing, computing for a page) outside the server's process;
* `maps`, `map_jobs`, `map_errands`: stiffness maps, also while they are being measured, and single hits of a map;
* `recordings`, `recording_errands`, `place`, `trash`: recordings of earlier runs;
* `regions`: the stiffnesses that linear theory finds stable and passive;
* `requests`: the requests that a page may send;
* `sessions`, `session_desk`, `session_lists`, `session_requests`: the operator's page of a participant's session, the
  session's process, the sessions that may be begun or resumed, and the requests of that page;
* `consent`, `terminal`: the confirmation by a person at the rig, typed in the console's terminal;
* `bounds`: limits of connections and messages, so that clients cannot overload the server;
* `server`: sockets and the page;
* `page/`: the page itself, plain modules and one vendored library.

A defect must affect as little as possible: one reply, one page's scope, or the followed loop. A defect in the page of a
session ends the session, which can be resumed. A defect in the supervision of leases ends the runs and the console.
"""

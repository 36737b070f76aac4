"""The live page in the browser, and what it starts.

* `access`: who may open the page at all: token, Host, Origin, and what a browser may load;
* `follow`, `history`, `trigger`, `view`: from a loop's rows to what one scope shows;
* `lease`: who operates, and what happens when they are gone;
* `live`, `runs`: the loop that is looked at; what a page starts and changes;
* `jobs`, `worker`: runs, in a process of their own, through the functions of the commands;
* `errands`, `errand_worker`: what is read, drawn and computed for a page, apart from the server;
* `maps`, `map_jobs`, `map_errands`: maps that fill in, and the hits of one;
* `recordings`, `recording_errands`, `place`, `trash`: what the runs left;
* `regions`: which walls theory finds stable and passive;
* `requests`: what a page may ask for;
* `sessions`, `session_desk`, `session_lists`, `session_requests`: the operator's seat, the session's side of it, what
  may be begun, and what is asked;
* `consent`, `terminal`: what a person at the rig agrees to, and where;
* `bounds`: how much of the server its clients may take;
* `server`: sockets and the page;
* `page/`: the page itself, plain modules and one vendored library.

A defect costs what it spoils: one reply, one page's scope, the loop that is followed. A session whose desk it was is
left, to be resumed; a defect in the watch over leases ends all that this console moves, and the console.
"""

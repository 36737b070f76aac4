"""The live page in the browser, and what it starts.

* `access`: who may open the page at all: token, Host, Origin, and what a browser may load;
* `follow`, `history`, `trigger`, `view`: from a loop's rows to what one scope shows;
* `lease`: who operates, and what happens when they are gone;
* `jobs`, `worker`: runs, in a process of their own, through the functions of the commands;
* `regions`: which walls theory finds stable and passive;
* `requests`: what a page may ask for;
* `server`: sockets and the page;
* `page/`: the page itself, plain modules and one vendored library.
"""

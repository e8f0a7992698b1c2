//! The page in a real browser, without a screen.

use std::io::Write;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tempfile::TempDir;

use crate::common::assert_says;
use crate::page::{ROW, page};
use crate::view_browser::Browser;

/// The page in a browser, and the folder that it lies in.
fn opened(page: &str) -> (TempDir, Browser) {
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("page.html");
    std::fs::write(&file, page).unwrap();
    let browser = Browser::open(&format!("file://{}", file.display()), 1200, 800);
    (dir, browser)
}

/// What a script returns that runs in a page.
fn said(page: &str, script: &str) -> String {
    let (_dir, browser) = opened(page);
    browser.run(script).as_str().unwrap().into()
}

/// A server that has nothing, and how often it was asked. Without an answer a browser would wait.
fn server() -> (SocketAddr, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, asked) = (listener.local_addr().unwrap(), Arc::new(AtomicUsize::new(0)));
    let count = asked.clone();
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            count.fetch_add(1, Ordering::SeqCst);
            let _ = stream.write_all(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        }
    });
    (address, asked)
}

#[test]
#[ignore = "needs Chromium"]
fn heads_sort_and_rows_and_columns_are_chosen() {
    let script = r##"
        const names = () => all(".results tbody tr").filter(row => !row.hidden).map(row => row.cells[0].textContent.slice(0, 4)).join(" ");
        const heads = all(".results thead button"), said = [names()];
        for (let i = 0; i < 3; i++) { heads[1].click(); said.push(names()); }
        heads[0].click();
        said.push(names());
        const filter = document.getElementById("filter");
        filter.value = "tv";
        filter.dispatchEvent(new Event("input"));
        said.push(names());
        const box = document.querySelector("input[data-group='1']");
        box.click();
        said.push(all(".results tr td").filter(cell => !cell.hidden && !cell.parentNode.hidden).length);
        said.push(csv().split("\n").length + " " + csv().split("\n")[1].split('","').length);
        return said.join("; ");
    "##;
    // Best first, then the other way round, then as it was; hidden are two rows and, of two metrics, one.
    let expected = "NeRF <scr TV; <scr NeRF TV; TV NeRF <scr; NeRF <scr TV; <scr NeRF TV; TV; 1; 2 3";
    assert_eq!(said(&page(), script), expected);
}

#[test]
#[ignore = "needs Chromium"]
fn the_slider_uncovers_one_row_s_picture_over_another_s() {
    let script = r##"
        const stage = document.querySelector(".stage"), [under, over] = all("img", stage), said = [stage.hidden];
        const [left, right, what] = all("select", stage), slider = stage.querySelector("input");
        const set = (control, value) => { control.value = value; control.dispatchEvent(new Event("input")); };
        const cell = (row, column) => all("table.views tbody tr")[row].cells[column].querySelector("img").src;
        said.push([...left.options].map(option => option.text).length);
        set(slider, 25);
        said.push(over.style.clipPath);
        set(left, 2); set(right, 3); set(what, "error");
        said.push(over.src === cell(2, 2) && under.src === cell(3, 2) && over.src !== under.src);
        set(left, 0);
        said.push(over.hasAttribute("src"), over.naturalWidth > 0 || under.naturalWidth > 0);
        return said.join("; ");
    "##;
    let expected = "false; 4; inset(0px 75% 0px 0px); true; false; true";
    assert_eq!(said(&page(), script), expected);
}

#[test]
#[ignore = "needs Chromium"]
fn the_page_s_policy_keeps_it_from_the_network_and_from_other_scripts() {
    let (address, fetched) = server();
    let foreign = format!("<img src=\"http://{address}/picture\"><script>document.title = 'run'</script>");
    let with_foreign = page().replace("<header>", &format!("{foreign}<header>"));
    let (_dir, kept) = opened(&with_foreign);
    assert_eq!(kept.value("document.title"), "Tiny & <b>bold</b>", "neither the script nor the row {ROW:?} ran");
    // The page's own script did.
    assert_says(kept.value("document.body.innerHTML").as_str().unwrap(), &["inset("]);
    assert_eq!(fetched.load(Ordering::SeqCst), 0, "something was fetched");
    // Without the policy both happen: the test can fail.
    let (start, rest) = with_foreign.split_once("<meta http-equiv").unwrap();
    let (_dir, open) = opened(&format!("{start}{}", rest.split_once('>').unwrap().1));
    assert_eq!(open.value("document.title"), "run");
    assert!(fetched.load(Ordering::SeqCst) > 0);
}
